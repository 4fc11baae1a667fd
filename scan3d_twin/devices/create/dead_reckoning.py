"""The odometry of a real Create: from encoder counts, or on a Create 1 from commands and readings.

Stamps: the base measures every 15 ms, but its bytes reach us with jitter, in lumps or late. The
earliest arrivals tell the true rhythm.
"""

from __future__ import annotations

import logging
import math
from typing import Protocol

import numpy as np

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import DeadReckoning
from scan3d_twin.core.navigation.wheel_kinematics import correct_reading, ramp_speed
from scan3d_twin.core.types import Odometry, read_only
from scan3d_twin.devices.create.link import Values
from scan3d_twin.devices.create.packets import Packet

log = logging.getLogger(__name__)

LEAK = 0.002
"""Share by which the rhythm may be slower than nominal before arrivals correct it; assumption."""
MAX_LAG = 4
"""Periods behind the arrivals after which the rhythm is taken anew."""
MAX_SPEED = 0.6
"""Wheels faster than this are a wrong reading [m/s]; the base does .5."""
SPARE_COUNTS, SPARE_SHARE = 10, 0.15
"""Allowed on top of what was commanded, and of that speed [counts, and share of the way]: jitter of
the stamps, and wheels that follow their command a little later; assumption."""
RESTARTED = 20
"""So many wrong readings in a row, 0.3 s of them, and the base has begun to count anew."""
COMMAND_ERROR = 0.05
"""Of a turn that was only commanded, not measured, standard deviation [rad/rad]; assumption."""


class SampleTimes:
    """Gives every reading the time at which it was measured."""

    def __init__(self, period: float, latency: float) -> None:
        self._period = period
        self._latency = latency
        self._last = -math.inf

    def stamps(self, count: int, now: float, *, gap: bool = False) -> list[float]:
        """Return the times [s] of ``count`` readings that had all arrived by ``now``, in order.

        Args:
            count: How many.
            now: [s].
            gap: Whether readings were lost before, so that the arrival alone tells the time.
        """
        if gap:
            self._last = max(self._last, now - self._latency - count * self._period)
        return [self._stamp(now - (count - 1 - k) * self._period) for k in range(count)]

    def _stamp(self, arrival: float) -> float:
        latest = arrival - self._latency
        stamp = min(latest, self._last + (1 + LEAK) * self._period)
        if latest - stamp > MAX_LAG * self._period:
            stamp = latest
        self._last = max(stamp, self._last + self._period / 10)
        return self._last


class Reckoning(Protocol):
    """How readings become odometry."""

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry | None:
        """Return the odometry at ``stamp`` [s]; None if the readings cannot be true, or not yet.

        Args:
            stamp: When they were measured.
            values: The readings.
            doubtful: Whether the line garbles bytes.
        """
        ...

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """Note that from ``stamp`` [s] on the base is told to drive so [m/s, rad/s]."""
        ...


class CommandedWheels:
    """Where the wheels should be by their commands, as fast as they can follow them."""

    def __init__(self, spec: BaseSpec, stamp: float) -> None:
        self._wheel_base = spec.wheel_base
        self._stamp = stamp
        self._speeds = self._told = (0.0, 0.0)

    def drive(self, linear: float, angular: float) -> None:
        """Take a command [m/s, rad/s], in force from the time the wheels are at."""
        side = angular * self._wheel_base / 2
        self._told = (linear - side, linear + side)

    def advance(self, stamp: float) -> tuple[float, float]:
        """Return how far the (left, right) wheel got [m] since the call before, by ``stamp``."""
        passed = max(0.0, stamp - self._stamp)
        self._stamp = max(stamp, self._stamp)
        left, right = (
            ramp_speed(speed, told, passed)
            for speed, told in zip(self._speeds, self._told, strict=True)
        )
        self._speeds = (left[1], right[1])
        return left[0], right[0]


class EncoderReckoning:
    """Odometry from the encoder counts, which are known modulo 2^16 only.

    Counts far from what was commanded are believed when the next reading goes on from there: a
    wheel is blocked, or the robot pushed. Counts no wheel can reach need several such readings: the
    base was switched off and on, and counts anew.
    """

    def __init__(self, spec: BaseSpec, stamp: float, values: Values) -> None:
        self._counts_per_metre = spec.counts_per_turn / (math.pi * spec.wheel_diameter)
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._wheels = CommandedWheels(spec, stamp)
        self._expected = [0.0, 0.0]
        self._total = [0, 0]
        self._raw = self._read(values)
        self._strange: tuple[float, list[int]] | None = None
        self._odd = 0
        self._stamp = stamp

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry | None:
        """See ``Reckoning.take``."""
        raw = self._read(values)
        self._advance(stamp)
        steps = _steps(self._raw, raw)
        if not self._as_commanded(steps):
            confirmed = self._goes_on(stamp, raw)
            self._strange = (stamp, raw)
            if not self._reachable(steps, stamp - self._stamp):
                if self._odd < RESTARTED:
                    return None
                log.warning("the base counts its wheels anew: it was switched off and on")
                steps = [0, 0]
            elif not confirmed:
                return None
        else:
            self._strange, self._odd = None, 0
        self._raw, self._stamp, self._expected = raw, stamp, [0.0, 0.0]
        self._total = [total + step for total, step in zip(self._total, steps, strict=True)]
        return self._reckoning.update(stamp, *self._total)

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """See ``Reckoning.drive``."""
        self._advance(stamp)
        self._wheels.drive(linear, angular)

    def _advance(self, stamp: float) -> None:
        ways = self._wheels.advance(stamp)
        self._expected = [
            counts + way * self._counts_per_metre
            for counts, way in zip(self._expected, ways, strict=True)
        ]

    def _read(self, values: Values) -> list[int]:
        return [values[Packet.LEFT_COUNTS], values[Packet.RIGHT_COUNTS]]

    def _as_commanded(self, steps: list[int]) -> bool:
        """Tell whether the wheels went ``steps`` [counts], as they were told."""
        return all(
            abs(step - expected) <= SPARE_COUNTS + SPARE_SHARE * abs(expected)
            for step, expected in zip(steps, self._expected, strict=True)
        )

    def _reachable(self, steps: list[int], passed: float) -> bool:
        """Tell whether wheels can turn by ``steps`` [counts] in the time ``passed`` [s]."""
        return max(map(abs, steps)) <= SPARE_COUNTS + MAX_SPEED * passed * self._counts_per_metre

    def _goes_on(self, stamp: float, raw: list[int]) -> bool:
        """Tell whether ``raw`` goes on from the strange reading before; count how often."""
        near = False
        if self._strange is not None:
            before, counts = self._strange
            near = self._reachable(_steps(counts, raw), stamp - before)
        self._odd = self._odd + 1 if near else 1
        return near


def _steps(before: list[int], after: list[int]) -> list[int]:
    """Return how far counters modulo 2^16 went, in either direction; exact up to 14 m."""
    return [((b - a + 32768) & 0xFFFF) - 32768 for a, b in zip(before, after, strict=True)]


class CommandedReckoning:
    """Odometry of a Create 1, which has no encoder counts.

    Its packets 19 and 20 are whole mm and degrees since the last read, and each read drops the
    fraction: read every 15 ms, a slow turn is 0. So the pose follows the commanded speeds, and the
    packets are read once at every rest. A reading says between which two numbers the truth lies;
    the commanded way and turn are only corrected to the nearer one.
    """

    def __init__(self, spec: BaseSpec, stamp: float) -> None:
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._wheels = CommandedWheels(spec, stamp)
        self._wheel_base = spec.wheel_base
        self._way = self._turn = 0.0
        self._variance = 0.0
        self._read_once = False

    @property
    def unread(self) -> bool:
        """Whether the base has moved since its packets were read."""
        return bool(self._way or self._turn) or not self._read_once

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry:
        """See ``Reckoning.take``; a reading in doubt changes nothing: what was commanded stands."""
        self._advance(stamp)
        if Packet.ANGLE in values:
            if doubtful:
                self._variance += (COMMAND_ERROR * self._turn) ** 2
            elif self._read_once:
                self._correct(stamp, values[Packet.DISTANCE], values[Packet.ANGLE])
            self._way = self._turn = 0.0
            self._read_once = True
        return self._odometry(stamp)

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """See ``Reckoning.drive``."""
        self._advance(stamp)
        self._wheels.drive(linear, angular)

    def _advance(self, stamp: float) -> None:
        """Follow the commands up to ``stamp`` [s]."""
        left, right = self._wheels.advance(stamp)
        way, turn = (left + right) / 2, (right - left) / self._wheel_base
        self._way, self._turn = self._way + way, self._turn + turn
        self._reckoning.advance(stamp, way, turn)

    def _correct(self, stamp: float, distance_mm: int, angle_deg: int) -> None:
        """Move by what a reading adds to the commands; at rest that is who pushed the robot."""
        if not (self._way or self._turn or distance_mm or angle_deg):
            return
        way, turn = correct_reading(self._way, self._turn, distance_mm, angle_deg)
        log.debug("corrected by %.1f mm and %.2f deg", 1e3 * way, math.degrees(turn))
        self._reckoning.advance(stamp, way, turn)
        self._variance += math.radians(1.0) ** 2 / 12

    def _odometry(self, stamp: float) -> Odometry:
        plain = self._reckoning.advance(stamp, 0.0, 0.0)
        extra = self._variance + (COMMAND_ERROR * self._turn) ** 2
        covariance = plain.covariance + np.diag([0.0, 0.0, extra])
        return Odometry(stamp, plain.T_odom_base, read_only(covariance))


def make_reckoning(spec: BaseSpec, stamp: float, values: Values) -> Reckoning:
    """Return the odometry of a base that sends ``values``, at rest at ``stamp`` [s]."""
    if Packet.LEFT_COUNTS in values:
        return EncoderReckoning(spec, stamp, values)
    return CommandedReckoning(spec, stamp)
