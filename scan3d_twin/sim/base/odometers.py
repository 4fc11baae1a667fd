"""Odometry of a base: by encoder counts, or on a Create 1 by its commands."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import DeadReckoning
from scan3d_twin.core.navigation.wheel_kinematics import correct_reading
from scan3d_twin.core.types import Odometry
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.sim.config import RobotErrorConfig

REST_TIME = 0.3
"""Standstill before a Create 1's packets are read [s]; the driver reads between motions."""


class Sample(NamedTuple):
    """The wheels at one sensor packet, every 15 ms.

    Attributes:
        stamp: Time of the packet [s].
        turned: Angle of the left and right wheel since opening [rad].
        sent: Commanded speed of the left and right rim [m/s].
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
    return CommandOdometer(device.spec, errors) if by_command else EncoderOdometer(device.spec)


class EncoderOdometer:
    """Odometry by wheel angles: packets 43 and 44 of a Create 2, packet 19 of a Create 1."""

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


class CommandOdometer:
    """Odometry of a Create 1 by its commands, corrected by its packets.

    A Create 1 only has packets 19 and 20: whole millimetres and degrees since the last read. Each
    read drops the fraction (libcreate issue 22), so that a turn of 5 deg/s read every 15 ms is 0.
    Therefore odometry integrates the commands; the packets, read at rest, correct it to the nearest
    value consistent with them.
    """

    def __init__(self, spec: BaseSpec, errors: RobotErrorConfig) -> None:
        self._spec, self._errors = spec, errors
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._stamp = self._moved = 0.0
        self._wheels = (0.0, 0.0)
        self._commanded = [0.0, 0.0]  # way [m] and turn [rad] commanded since the last read
        self._unread = [0.0, 0.0]  # way [m] and turn [rad] that the firmware counted since

    def update(self, sample: Sample) -> Odometry:
        """See ``Odometer``."""
        stamp, passed = sample.stamp, sample.stamp - self._stamp
        self._stamp = stamp
        way, turn = (speed * passed for speed in self._way_and_turn(sample.sent))
        self._commanded = [self._commanded[0] + way, self._commanded[1] + turn]
        self._count(sample.turned)
        if any(sample.sent):
            self._moved = stamp
        elif any(self._commanded) and stamp - self._moved >= REST_TIME:
            way, turn = self._correction()
        return self._reckoning.advance(stamp, way, turn)

    def _way_and_turn(self, sides: tuple[float, float]) -> tuple[float, float]:
        return (sides[0] + sides[1]) / 2, (sides[1] - sides[0]) / self._spec.wheel_base

    def _count(self, turned: tuple[float, float]) -> None:
        """Add the turns of the wheels to the counters of the firmware."""
        radius = self._spec.wheel_diameter / 2
        left, right = (radius * (b - a) for a, b in zip(self._wheels, turned, strict=True))
        self._wheels = turned
        way, turn = self._way_and_turn((left, right))
        self._unread[0] += abs(way) if self._errors.distance_unsigned else way
        self._unread[1] += turn * self._errors.angle_gain

    def _correction(self) -> tuple[float, float]:
        """Read packets 19 and 20; return the correction of the commanded way and turn."""
        distance, angle = int(1e3 * self._unread[0]), int(math.degrees(self._unread[1]))
        rest = (self._unread[0] - distance / 1e3, self._unread[1] - math.radians(angle))
        self._unread = [0.0, 0.0] if self._errors.truncates else [*rest]
        way, turn = correct_reading(self._commanded[0], self._commanded[1], distance, angle)
        self._commanded = [0.0, 0.0]
        return way, turn
