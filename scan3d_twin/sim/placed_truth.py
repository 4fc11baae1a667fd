"""The truth of a run whose scanner was set down by hand at several places."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.truth import Truth

Place = tuple[float, Pose2]
"""Time from which on the scanner stood there [s], and its true ``T_map_base``."""


class PlacedTruth:
    """A ``Truth`` with the poses of ``places``, and all else of the twin that is open.

    Args:
        truth: Of the twin, wherever its scanner stands.
        spawn: Where the scanner stood first, in ``map``.
        places: Where it stood later, by time.
    """

    def __init__(self, truth: Truth, spawn: Pose2, places: Sequence[Place]) -> None:
        self._truth, self._spawn = truth, spawn
        self._places = sorted(places, key=lambda place: place[0])

    @property
    def spawn(self) -> Pose2:
        """See ``Truth``: where the scanner stood first."""
        return self._spawn

    @property
    def front(self) -> Pose2 | None:
        """See ``Truth``."""
        return self._truth.front

    @property
    def latest(self) -> float:
        """See ``Truth``: it stands at the last place for ever."""
        return math.inf

    def pose_at(self, stamp: float) -> Pose2:
        """See ``Truth``."""
        k = bisect_right([start for start, _ in self._places], stamp)
        return self._places[k - 1][1] if k else self._spawn

    def poses_at(self, stamps: FloatArray) -> FloatArray:
        """See ``Truth``."""
        poses = [self.pose_at(stamp) for stamp in stamps.tolist()]
        return np.array([(pose.x, pose.y, pose.yaw) for pose in poses])

    @property
    def targets(self) -> tuple[str, ...]:
        """See ``Truth``."""
        return self._truth.targets

    @property
    def notes(self) -> tuple[str, ...]:
        """See ``Truth``."""
        return self._truth.notes

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """See ``Truth``."""
        return self._truth.surface(spacing, targets)

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """See ``Truth``."""
        return self._truth.first_hits(origins, directions)

    def first_opaque_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """See ``Truth``."""
        return self._truth.first_opaque_hits(origins, directions)

    def locate_shown(self, name: str) -> tuple[float, float]:
        """See ``Truth``."""
        return self._truth.locate_shown(name)
