"""What a recorded run had done at a time: views finished, lines read, the way driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.viz.track import place_track


@dataclass(frozen=True, eq=False)
class Timeline:
    """Times of a run on the robot's clock [s].

    Attributes:
        starts: Stamp of the first line of each view (n,).
        ends: Stamp of the last line of each view (n,).
        stamps: Times of the poses below (m,), ascending.
        poses: Poses x, y [m], yaw [rad] in ``world`` (m, 3), as the final alignment places them.
    """

    starts: FloatArray
    ends: FloatArray
    stamps: FloatArray
    poses: FloatArray

    @staticmethod
    def of(session: Session, track: FloatArray) -> Timeline:
        """Return the timeline of ``session`` with the ``track`` (m, 4) of ``read_track``.

        Without a track the robot stands at its viewpoints, and jumps from one to the next.
        """
        lines = [view.observation.image.stamps for view in session.views]
        starts = np.array([float(each.min()) for each in lines])
        ends = np.array([float(each.max()) for each in lines])
        if len(track):
            return Timeline(starts, ends, track[:, 0], place_track(track, session))
        places = [
            (view.T_world_scan.x, view.T_world_scan.y, view.T_world_scan.yaw)
            for view in session.views
        ]
        return Timeline(starts, ends, ends, np.array(places).reshape(-1, 3))

    @property
    def end(self) -> float:
        """Time of the last thing known [s]."""
        return float(max(self.ends[-1], self.stamps[-1]))

    def count_finished(self, time: float) -> int:
        """Return the number of views finished at ``time`` [s]."""
        return int(np.searchsorted(self.ends, time, side="right"))

    def lines_read(self, view: int, session: Session, time: float) -> int:
        """Return the number of lines of ``view`` that were read at ``time`` [s]."""
        stamps = session.views[view].observation.image.stamps
        return int(np.count_nonzero(stamps <= time))

    def pose_at(self, time: float) -> Pose2:
        """Return ``T_world_base`` at ``time`` [s]."""
        x, y, yaw = (float(np.interp(time, self.stamps, self.poses[:, k])) for k in range(3))
        return Pose2(x, y, yaw)

    def path_until(self, time: float) -> FloatArray:
        """Return the way driven until ``time`` [s] (k, 2) in ``world`` [m]."""
        return self.poses[: np.searchsorted(self.stamps, time, side="right"), :2]
