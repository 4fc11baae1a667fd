"""The simulated stand: a base that stays where it was put."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.types import Hazards, Odometry, Pose2, read_only
from scan3d_twin.sim.world import World

_NO_COVARIANCE = read_only(np.zeros((3, 3)))


class SimStand:
    """A ``DriveBase`` without wheels on the twin; a ``Device`` of its clock."""

    def __init__(self, world: World, spec: BaseSpec) -> None:
        self.spec = spec
        self._world = world
        self._samples = 0
        self.next_step = self._due(1)

    def _due(self, sample: int) -> int:
        """Return the physics step at which sample number ``sample`` is due."""
        return math.ceil(sample * self.spec.sample_period / self._world.timestep - 1e-9)

    def service(self) -> None:
        """Take a sample: of nothing that moves."""
        self._samples += 1
        self.next_step = self._due(self._samples + 1)

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``.

        Raises:
            ConfigError: It is to move.
        """
        refuse_driving(linear, angular)
        return 0.0, 0.0

    def stop(self) -> None:
        """Do nothing: it stands."""

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``: the identity."""
        return self._odometry(self._samples)

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``: samples without motion."""
        first = max(0, math.floor(stamp / self.spec.sample_period + 1e-9))
        first = min(first, self._samples)
        return tuple(self._odometry(k) for k in range(first, self._samples + 1))

    def _odometry(self, sample: int) -> Odometry:
        return Odometry(sample * self.spec.sample_period, Pose2(), _NO_COVARIANCE)

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``: there are none."""
        return Hazards()

    def sense(self) -> Hazards:
        """Return what its safety sensors report: it has none."""
        return Hazards()


def refuse_driving(linear: float, angular: float) -> None:
    """Refuse to drive a stand at ``linear`` [m/s] and ``angular`` [rad/s].

    Raises:
        ConfigError: One is not 0.
    """
    if linear != 0.0 or angular != 0.0:
        raise ConfigError(
            f"a stand does not drive, got {linear:g} m/s and {angular:g} rad/s; choose a base with "
            "wheels"
        )
