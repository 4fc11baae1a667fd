"""How a base knows where it is: by encoder counts, or on a Create 1 by its commands."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import DeadReckoning
from scan3d_twin.core.navigation.wheel_kinematics import correction
from scan3d_twin.core.types import Odometry
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.sim.config import RobotErrorConfig

AT_REST = 0.3
"""Standstill after which a Create 1's packets are read [s]; the driver reads between motions."""


class Sample(NamedTuple):
    """What one sensor packet of 15 ms holds.

    Attributes:
        stamp: [s].
        turned: Angle of the left and right wheel since opening [rad].
        sent: Speed of the left and right rim that the motors were told [m/s].
    """

    stamp: float
    turned: tuple[float, float]
    sent: tuple[float, float]


class Odometer(Protocol):
    """Turns packets into odometry."""

    def update(self, sample: Sample) -> Odometry:
        """Return the odometry after ``sample``."""
        ...


def make_odometer(device: BaseDevice, errors: RobotErrorConfig) -> Odometer:
    """Return the odometer of a base."""
    by_command = not device.counts and errors.reckoning == "driver"
    return Commanded(device.spec, errors) if by_command else Encoders(device.spec)


class Encoders:
    """What the wheels turned: packets 43 and 44 of a Create 2, whole millimetres of a Create 1."""

    def __init__(self, spec: BaseSpec) -> None:
        self._per_radian = spec.counts_per_turn / math.tau
        self._reckoning = DeadReckoning(spec, 0, 0)

    def update(self, sample: Sample) -> Odometry:
        """See ``Odometer``."""
        left, right = sample.turned
        # Rounded, not floored: at rest it stands in the middle of a count, not on its edge.
        return self._reckoning.update(
            sample.stamp, round(left * self._per_radian), round(right * self._per_radian)
        )


class Commanded:
    """A Create 1 has packets 19 and 20 only: whole mm and degrees since they were read last.

    Each read drops the fraction (libcreate issue 22), so that a turn of 5 deg/s read every 15 ms
    is 0. So the way is that of the commands, and the packets, read at rest, only correct it to the
    nearest number they allow.
    """

    def __init__(self, spec: BaseSpec, errors: RobotErrorConfig) -> None:
        self._spec, self._errors = spec, errors
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._stamp = self._moved = 0.0
        self._wheels = (0.0, 0.0)
        self._told = [0.0, 0.0]  # way [m] and turn [rad] commanded since the last read
        self._unread = [0.0, 0.0]  # what the firmware counted since

    def update(self, sample: Sample) -> Odometry:
        """See ``Odometer``."""
        stamp, passed = sample.stamp, sample.stamp - self._stamp
        self._stamp = stamp
        way, turn = (speed * passed for speed in self._way_and_turn(sample.sent))
        self._told = [self._told[0] + way, self._told[1] + turn]
        self._count(sample.turned)
        if any(sample.sent):
            self._moved = stamp
        elif any(self._told) and stamp - self._moved >= AT_REST:
            way, turn = self._correction()
        return self._reckoning.advance(stamp, way, turn)

    def _way_and_turn(self, sides: tuple[float, float]) -> tuple[float, float]:
        return (sides[0] + sides[1]) / 2, (sides[1] - sides[0]) / self._spec.wheel_base

    def _count(self, turned: tuple[float, float]) -> None:
        """Let the firmware count how far the wheels turned."""
        radius = self._spec.wheel_diameter / 2
        left, right = (radius * (b - a) for a, b in zip(self._wheels, turned, strict=True))
        self._wheels = turned
        way, turn = self._way_and_turn((left, right))
        self._unread[0] += abs(way) if self._errors.distance_unsigned else way
        self._unread[1] += turn * self._errors.angle_gain

    def _correction(self) -> tuple[float, float]:
        """Read packets 19 and 20; return what they add to the commanded way and turn."""
        distance, angle = int(1e3 * self._unread[0]), int(math.degrees(self._unread[1]))
        rest = (self._unread[0] - distance / 1e3, self._unread[1] - math.radians(angle))
        self._unread = [0.0, 0.0] if self._errors.truncates else [*rest]
        way, turn = correction(self._told[0], self._told[1], distance, angle)
        self._told = [0.0, 0.0]
        return way, turn
