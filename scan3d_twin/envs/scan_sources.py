"""Scan sources of an episode: the twin with its physics, or the kinematic robot without."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.navigation.costmap import Costmap, build_costmap
from scan3d_twin.core.navigation.legs import measure_legs
from scan3d_twin.core.navigation.motion_control import follow_path
from scan3d_twin.core.planning.sweep_choice import choose_sector
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, LidarSpec, Observation, Pose2, ScanLine
from scan3d_twin.envs.prepared_scenes import PreparedScene
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import KinematicRobot, Thinning
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.world import Solver


class EpisodeScanSource(ABC):
    """A ``ScanSource`` that keeps the costmap of an episode and the distance driven.

    Attributes:
        driven: Distance driven [m].
        truth: True poses and surface, for rewards and metrics only.
    """

    truth: Truth

    def __init__(self, config: Config) -> None:
        self.config = config
        self.driven = 0.0
        self._costmap: tuple[Session, Costmap] | None = None

    @property
    @abstractmethod
    def here(self) -> Pose2:
        """Pose of the robot, ``T_odom_base``."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Time since the robot was opened [s]."""

    @abstractmethod
    def take_panorama(self, session: Session | None = None) -> Observation:
        """See ``ScanSource``; there is no session before the first panorama."""

    @abstractmethod
    def _go(
        self, path: FloatArray, yaw: float, half: float | None, beyond: float
    ) -> tuple[Observation, list[Pose2]]:
        """Drive along ``path`` (n, 2) in ``odom`` [m] and sweep a sector about ``yaw``.

        Returns:
            The sweep, and the poses by odometry on the way.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop the robot."""

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """See ``ScanSource``."""
        # Drive and sweep
        here = self.here
        path = _find_path(self.costmap_from(here, session), viewpoint)
        places = [np.array([here.x, here.y]), *path]
        self.driven += sum(float(np.linalg.norm(b - a)) for a, b in pairwise(places))
        seen, poses = self._go(path, viewpoint.yaw, *choose_sector(session, viewpoint))

        # Keep how the wheels moved since the latest view
        before = session.views[-1].observation.T_odom_scan if session.views else poses[0]
        legs = measure_legs(before, poses, seen.T_odom_scan.yaw)
        return replace(seen, legs=legs)

    def costmap_from(self, start: Pose2, session: Session) -> Costmap:
        """Return the costmap with the robot at ``start`` in ``odom``, by what ``session`` saw."""
        if self._costmap is None or not _saw_the_same(self._costmap[0], session):
            costmap = build_costmap(
                session.observations(), self.config, start, workspace=session.workspace
            )
            self._costmap = session, costmap
        known = self._costmap[1]
        if (start.x, start.y) == tuple(known.start):
            return known
        return replace(known, start=np.array([start.x, start.y]))


def _find_path(costmap: Costmap, viewpoint: Pose2) -> FloatArray:
    """Return the waypoints (n, 2) in ``odom`` [m] to ``viewpoint``, around obstacles.

    Raises:
        ScanError: There is no path.
    """
    path = costmap.find_path(viewpoint.x, viewpoint.y)
    if path is None:
        raise ScanError(f"no way to the viewpoint at ({viewpoint.x:.2f}, {viewpoint.y:.2f}) m")
    return path


def _saw_the_same(a: Session, b: Session) -> bool:
    """Return whether two sessions differ by plans at most: those change nothing that was seen."""
    return a.views is b.views and a.panoramas is b.panoramas


class PhysicsScanSource(EpisodeScanSource):
    """Scans with the twin in MuJoCo."""

    def __init__(
        self,
        prepared: PreparedScene,
        seed: int,
        config: Config,
        twin: TwinConfig,
        *,
        solver: Solver | None = None,
        spec: LidarSpec | None = None,
    ) -> None:
        super().__init__(config)
        self._open = ExitStack()
        opening = open_sim(prepared.scene, seed, twin, solver=solver, spec=spec)
        self._robot, self.truth = self._open.enter_context(opening)

    @property
    def here(self) -> Pose2:
        """See ``EpisodeScanSource``."""
        return self._robot.base.odometry().T_odom_base

    @property
    def time(self) -> float:
        """See ``EpisodeScanSource``."""
        return self._robot.clock.now()

    def close(self) -> None:
        """See ``EpisodeScanSource``."""
        self._open.close()

    def take_panorama(self, session: Session | None = None) -> Observation:
        """See ``EpisodeScanSource``."""
        return take_panorama(self._robot, self.config, _ignore_line)

    def _go(
        self, path: FloatArray, yaw: float, half: float | None, beyond: float
    ) -> tuple[Observation, list[Pose2]]:
        started = self.time
        follow_path(self._robot, path, self.config.motion)
        seen = sweep(self._robot, yaw, self.config, _ignore_line, half, beyond)
        return seen, [each.T_odom_base for each in self._robot.base.odometry_since(started)]


def _ignore_line(line: ScanLine) -> None:
    """Ignore a line: an episode has no observer."""


class KinematicScanSource(EpisodeScanSource):
    """Scans with a kinematic robot, without physics."""

    def __init__(
        self,
        prepared: PreparedScene,
        seed: int,
        config: Config,
        twin: TwinConfig,
        thinning: Thinning,
    ) -> None:
        super().__init__(config)
        self._robot = KinematicRobot(prepared.scene, prepared.caster, seed, twin, config, thinning)
        self.truth = self._robot.truth

    @property
    def here(self) -> Pose2:
        """See ``EpisodeScanSource``."""
        return self._robot.here

    @property
    def time(self) -> float:
        """See ``EpisodeScanSource``."""
        return self._robot.world.time

    def close(self) -> None:
        """See ``EpisodeScanSource``: the robot stands still anyway."""

    def take_panorama(self, session: Session | None = None) -> Observation:
        """See ``EpisodeScanSource``."""
        return self._robot.take_panorama()

    def _go(
        self, path: FloatArray, yaw: float, half: float | None, beyond: float
    ) -> tuple[Observation, list[Pose2]]:
        poses = [self.here]
        for x, y in path.tolist():
            heading = math.atan2(y - poses[-1].y, x - poses[-1].x)
            poses += [Pose2(poses[-1].x, poses[-1].y, heading), Pose2(x, y, heading)]
        return self._robot.observe(path, yaw, half, beyond), poses
