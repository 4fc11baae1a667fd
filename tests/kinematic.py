"""Test helper: a drive base that follows commands exactly, on a clock that only jumps."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import drive_arc
from scan3d_twin.core.types import Hazards, Odometry, Pose2

CREATE2 = BaseSpec("create2", 0.165, 0.235, 0.072, 508.8, 0.5, 0.015)
NOTHING = np.zeros((3, 3))


class KinematicBase:
    """A ``DriveBase``, by default without inertia; ``hazard`` may be set at any time."""

    def __init__(self, spec: BaseSpec = CREATE2, acceleration: float = math.inf) -> None:
        """Start at rest; ``acceleration`` is that of the wheels' rims [m/s2]."""
        self.spec = spec
        self.acceleration = acceleration
        self.wheels = (0.0, 0.0)
        self.hazard = Hazards()
        self.speed = (0.0, 0.0)
        self._samples = [Odometry(0.0, Pose2(), NOTHING)]

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``."""
        self.speed = (linear, angular)
        return self.speed

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        return self._samples[-1]

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        after = bisect_right(self._samples, stamp, key=lambda sample: sample.stamp)
        return tuple(self._samples[max(0, after - 1) :])

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self.hazard

    def advance(self) -> None:
        """Move on by one sample period."""
        linear, angular = (speed * self.spec.sample_period for speed in self._followed())
        last = self._samples[-1]
        stamp = len(self._samples) * self.spec.sample_period
        self._samples.append(
            Odometry(stamp, last.T_odom_base @ drive_arc(linear, angular), NOTHING)
        )

    def _followed(self) -> tuple[float, float]:
        """Return the (linear, angular) speed of the wheels, which follow the command."""
        if math.isinf(self.acceleration):
            return self.speed
        width, step = self.spec.wheel_base, self.acceleration * self.spec.sample_period
        wanted = [self.speed[0] + side * self.speed[1] * width / 2 for side in (-1, 1)]
        left, right = (
            now + max(-step, min(step, end - now))
            for now, end in zip(self.wheels, wanted, strict=True)
        )
        self.wheels = (left, right)
        return (left + right) / 2, (right - left) / width


class JumpingClock:
    """A ``Clock`` that moves ``base`` along."""

    def __init__(self, base: KinematicBase) -> None:
        self._base = base
        self._time = 0.0

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._time

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``; moves the base along."""
        self._time += max(0.0, seconds)
        period = self._base.spec.sample_period
        while self._base.odometry().stamp + period <= self._time + 1e-9:
            self._base.advance()


def turned(base: KinematicBase) -> float:
    """Return the sum of all turns of ``base`` [rad], more than half a turn included."""
    yaws = [sample.T_odom_base.yaw for sample in base.odometry_since(0.0)]
    return float(np.unwrap(yaws)[-1]) if yaws else math.nan
