"""One episode: the loop of ``core.digitize`` with the decisions left to whoever acts."""

from __future__ import annotations

import math
from functools import cached_property

from scan3d_twin.core.digitize import iterate_views, start_session
from scan3d_twin.core.navigation.costmap import Costmap
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.scanning.extrinsic_calibration import apply_yaw_scale, calibrate_on_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.observations import sees_target
from scan3d_twin.envs.scoring import Score
from scan3d_twin.envs.scouts import EpisodeScout
from scan3d_twin.envs.stage import Stage

LOOK = Plan(None, 0.0, math.nan, False, (), "look around", needs_panorama=True)


class Episode:
    """A run under way: its session, and how well it goes.

    Attributes:
        session: All that the robot knows.
        scout: Takes the sweeps.
        score: By the truth, for rewards and metrics.
        stage: Where it takes place.
    """

    def __init__(self, stage: Stage, scout: EpisodeScout, seed: int) -> None:
        self.stage, self.scout = stage, scout
        panorama = scout.take_panorama()
        calibration = calibrate_on_panorama(panorama.image)
        scout.config = apply_yaw_scale(scout.config, calibration)
        session, viewpoint = start_session(panorama, scout.here, scout.config, seed, None)
        self._loop = iterate_views(scout, session, viewpoint)
        self.session: Session = next(self._loop)
        self.score = Score(stage, scout.truth, self.session)
        self.score.update(self.session)

    @cached_property
    def _known(self) -> tuple[Session, PlanningContext]:
        """The context after the latest view or look."""
        return self.session, PlanningContext(self.session, self.costmap)

    @property
    def context(self) -> PlanningContext:
        """What the planners ask first, on the costmap that the robot keeps."""
        if self._known[0] is not self.session:
            del self._known
        return self._known[1]

    @property
    def costmap(self) -> Costmap:
        """Where the robot can go from the latest view."""
        return self.scout.floor(self.session.views[-1].observation.T_odom_scan)

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
        """Look around from here, unless this was done already."""
        if not self.context.has_panorama:
            self.session = self._loop.send(LOOK)

    def close(self) -> None:
        """Stop the robot."""
        self._loop.close()
        self.scout.close()
