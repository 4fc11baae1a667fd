"""The driver of a stand: a ``DriveBase`` that stays where it was put, and has no line."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import Hazards, Odometry, Pose2, read_only
from scan3d_twin.devices.stand.model import STAND

_NO_COVARIANCE = read_only(np.zeros((3, 3)))


class Stand:
    """A ``DriveBase`` without wheels.

    Attributes:
        spec: See ``DriveBase.spec``.
        bad: See ``BaseDriver.bad``: nothing arrives.
    """

    spec = STAND
    bad = 0

    def __init__(self, clock: Clock) -> None:
        """Stand there; ``clock`` stamps the odometry."""
        self._clock = clock

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``.

        Raises:
            ConfigError: It is to move.
        """
        if linear != 0.0 or angular != 0.0:
            raise ConfigError(
                f"a stand does not drive, got {linear:g} m/s and {angular:g} rad/s; choose a base "
                "with wheels"
            )
        return 0.0, 0.0

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``: the identity."""
        return self._sample(self._latest())

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``: samples without motion."""
        latest = self._latest()
        first = min(latest, max(0, math.floor(stamp / self.spec.sample_period + 1e-9)))
        return tuple(map(self._sample, range(first, latest + 1)))

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``: there are none."""
        return Hazards()

    def service(self, now: float) -> None:
        """See ``BaseDriver.service``."""

    def close(self) -> None:
        """See ``BaseDriver.close``."""

    def _latest(self) -> int:
        """Return the number of the latest sample."""
        return max(0, math.floor(self._clock.now() / self.spec.sample_period + 1e-9))

    def _sample(self, number: int) -> Odometry:
        return Odometry(number * self.spec.sample_period, Pose2(), _NO_COVARIANCE)
