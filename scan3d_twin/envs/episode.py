"""One episode: the loop of ``core.digitize`` with the plans from outside."""

from __future__ import annotations

import math
from functools import cached_property

from scan3d_twin.core.digitize import iterate_views
from scan3d_twin.core.navigation.costmap import Costmap
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.scanning.calibration.lidar_mount import apply_yaw_scale, calibrate_on_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.session_start import start_session
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.observations import sees_target
from scan3d_twin.envs.prepared_scenes import PreparedScene
from scan3d_twin.envs.scan_sources import EpisodeScanSource
from scan3d_twin.envs.scoring import Score

PANORAMA_PLAN = Plan(None, 0.0, math.nan, False, (), "look around", needs_panorama=True)


class Episode:
    """A run in progress: its session and its score.

    Attributes:
        session: Everything the robot knows.
        source: Takes the sweeps.
        score: Coverage and errors by the truth, for rewards and metrics.
        prepared: The scene.
    """

    def __init__(self, prepared: PreparedScene, source: EpisodeScanSource, seed: int) -> None:
        self.prepared, self.source = prepared, source

        # Calibrate on the first panorama.
        panorama = source.take_panorama()
        calibration = calibrate_on_panorama(panorama.image)
        source.config = apply_yaw_scale(source.config, calibration)

        # Take the first view.
        session, viewpoint = start_session(panorama, source.here, source.config, seed, None)
        self._loop = iterate_views(source, session, viewpoint)
        self.session: Session = next(self._loop)
        self.score = Score(prepared, source.truth, self.session)
        self.score.update(self.session)

    @cached_property
    def _known(self) -> tuple[Session, PlanningContext]:
        """The session and its context after the latest view or panorama."""
        return self.session, PlanningContext(self.session, self.costmap)

    @property
    def context(self) -> PlanningContext:
        """The planning context of the latest view, on the costmap that the robot keeps."""
        if self._known[0] is not self.session:
            del self._known
        return self._known[1]

    @property
    def costmap(self) -> Costmap:
        """Costmap from the latest view."""
        here = self.session.views[-1].observation.T_odom_scan
        return self.source.costmap_from(here, self.session)

    @property
    def sees_target(self) -> bool:
        """Whether the latest view shows enough of the target for a contour."""
        return sees_target(self.context)

    def go(self, plan: Plan) -> None:
        """Carry out ``plan``, which has a viewpoint.

        Raises:
            TwinError: From the robot.
        """
        self.session = self._loop.send(plan)
        self.score.update(self.session)

    def look(self) -> None:
        """Take a panorama from here, unless there is one."""
        if not self.context.has_panorama:
            self.session = self._loop.send(PANORAMA_PLAN)

    def close(self) -> None:
        """Stop the robot."""
        self._loop.close()
        self.source.close()
