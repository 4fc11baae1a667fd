"""Who takes the sweeps of an episode: the twin with its physics, or the robot without any."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import find_path
from scan3d_twin.core.model.evaluation import Truth
from scan3d_twin.core.navigation.costmap import Costmap, build_costmap, extend_costmap
from scan3d_twin.core.navigation.motion_control import follow_path
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, LidarSpec, Observation, Pose2, ScanLine
from scan3d_twin.envs.stage import Stage
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import KinematicRobot, Thinning
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.world import Solver


class EpisodeScout(ABC):
    """A ``ScanSource`` that remembers the floor it has seen and the way it has driven.

    Attributes:
        driven: [m].
        truth: For rewards and metrics alone.
    """

    truth: Truth

    def __init__(self, config: Config) -> None:
        self.config = config
        self.driven = 0.0
        self._costmap: Costmap | None = None

    @property
    @abstractmethod
    def here(self) -> Pose2:
        """Where the robot stands, ``T_odom_base``."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Since the robot was opened [s]."""

    @abstractmethod
    def _look(self) -> Observation:
        """Look around."""

    @abstractmethod
    def _go(self, path: FloatArray, yaw: float) -> Observation:
        """Drive along ``path`` (n, 2) in ``odom`` [m] and sweep about ``yaw``."""

    @abstractmethod
    def close(self) -> None:
        """Stop the robot."""

    def take_panorama(self, session: Session | None = None) -> Observation:
        """See ``ScanSource``."""
        return self._noted(self._look())

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """See ``ScanSource``."""
        path = find_path(self.floor(self.here), viewpoint)
        here = self.here
        places = [np.array([here.x, here.y]), *path]
        self.driven += sum(float(np.linalg.norm(b - a)) for a, b in pairwise(places))
        return self._noted(self._go(path, viewpoint.yaw))

    def floor(self, start: Pose2) -> Costmap:
        """Return where the robot can go from ``start`` in ``odom``."""
        if self._costmap is None:
            raise ValueError("nothing was seen yet: look around first")
        if (start.x, start.y) != tuple(self._costmap.start):
            self._costmap = replace(self._costmap, start=np.array([start.x, start.y]))
        return self._costmap

    def _noted(self, seen: Observation) -> Observation:
        place = seen.T_odom_scan
        if self._costmap is None:
            self._costmap = build_costmap((seen,), self.config, place)
        else:
            self._costmap = extend_costmap(self._costmap, seen, self.config, place)
        return seen


class PhysicsScout(EpisodeScout):
    """Drives the twin."""

    def __init__(
        self,
        stage: Stage,
        seed: int,
        config: Config,
        twin: TwinConfig,
        *,
        solver: Solver | None = None,
        spec: LidarSpec | None = None,
    ) -> None:
        super().__init__(config)
        self._open = ExitStack()
        opening = open_sim(stage.scene, seed, twin, solver=solver, spec=spec)
        self._robot, self.truth = self._open.enter_context(opening)

    @property
    def here(self) -> Pose2:
        """See ``EpisodeScout``."""
        return self._robot.base.odometry().T_odom_base

    @property
    def time(self) -> float:
        """See ``EpisodeScout``."""
        return self._robot.clock.now()

    def close(self) -> None:
        """See ``EpisodeScout``."""
        self._open.close()

    def _look(self) -> Observation:
        return take_panorama(self._robot, self.config, _unseen)

    def _go(self, path: FloatArray, yaw: float) -> Observation:
        follow_path(self._robot, path, self.config.motion)
        return sweep(self._robot, yaw, self.config, _unseen)


def _unseen(line: ScanLine) -> None:
    """Nobody watches the lines."""


class KinematicScout(EpisodeScout):
    """Moves the robot without physics."""

    def __init__(
        self, stage: Stage, seed: int, config: Config, twin: TwinConfig, thinning: Thinning
    ) -> None:
        super().__init__(config)
        self._robot = KinematicRobot(stage.scene, stage.caster, seed, twin, config, thinning)
        self.truth = self._robot.truth

    @property
    def here(self) -> Pose2:
        """See ``EpisodeScout``."""
        return self._robot.here

    @property
    def time(self) -> float:
        """See ``EpisodeScout``."""
        return self._robot.world.time

    def close(self) -> None:
        """See ``EpisodeScout``: it stands already."""

    def _look(self) -> Observation:
        return self._robot.take_panorama()

    def _go(self, path: FloatArray, yaw: float) -> Observation:
        return self._robot.observe(path, yaw)
