"""Test helper: a turntable that moves by an exact profile, in virtual time."""

import math
from bisect import bisect_right
from dataclasses import dataclass

from scan3d_twin.core.types import TableAngle
from scan3d_twin.devices.dynamixel.spec import SPEC


@dataclass(frozen=True)
class Motion:
    """One motion from rest to rest, in a trapezoidal profile."""

    begin: float
    first: float
    last: float
    speed: float
    acceleration: float

    def at(self, time):
        """Return the angle at ``time`` [rad]."""
        passed, distance = max(0.0, time - self.begin), abs(self.last - self.first)
        speed = min(self.speed, math.sqrt(distance * self.acceleration))
        ramp = speed / self.acceleration
        if distance == 0.0:
            return self.last
        end = ramp + distance / speed
        if passed >= end:
            return self.last
        if passed < ramp:
            way = self.acceleration * passed**2 / 2
        elif passed <= end - ramp:
            way = speed * (passed - ramp / 2)
        else:
            way = distance - self.acceleration * (end - passed) ** 2 / 2
        return self.first + math.copysign(way, self.last - self.first)


class VirtualTable:
    """A ``Turntable`` on a virtual clock; it stops at once."""

    def __init__(self, clock, angle=0.0, acceleration=2.0, period=0.002):
        self.spec, self.blocked = SPEC, False
        self.orders = []
        self._clock, self._acceleration, self._period = clock, acceleration, period
        self._motions = [Motion(-math.inf, angle, angle, 1.0, 1.0)]

    def at(self, time):
        """Return the true angle at ``time`` [rad]."""
        last = bisect_right(self._motions, time, key=lambda each: each.begin) - 1
        return self._motions[last].at(time)

    def turn_to(self, angle, speed):
        """See ``Turntable.turn_to``."""
        now = self._clock.now()
        self.orders.append((now, angle, speed))
        if not self.blocked:
            self._motions.append(Motion(now, self.at(now), angle, speed, self._acceleration))
        return angle, speed

    def stop(self):
        """See ``Turntable.stop``."""
        now, here = self._clock.now(), self.at(self._clock.now())
        self._motions.append(Motion(now, here, here, 1.0, 1.0))

    def forget(self, time):
        """Forget all motions that were over before ``time`` [s]."""
        last = bisect_right(self._motions, time, key=lambda each: each.begin) - 1
        del self._motions[:last]
        del self.orders[:-10]

    def turn_by_hand(self, angle):
        """Be at another ``angle`` [rad] at once."""
        self._motions.append(Motion(self._clock.now(), angle, angle, 1.0, 1.0))

    def angle(self):
        """See ``Turntable.angle``."""
        return self.angles_since(self._clock.now())[-1]

    def angles_since(self, stamp):
        """See ``Turntable.angles_since``."""
        first = math.floor(stamp / self._period)
        last = math.floor(self._clock.now() / self._period + 1e-9)
        times = [k * self._period for k in range(max(0, first), last + 1)]
        return tuple(TableAngle(time, self.at(time)) for time in times)
