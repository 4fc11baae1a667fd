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
from scan3d_twin.core.odometry import DeadReckoning
from scan3d_twin.core.types import Odometry, read_only
from scan3d_twin.core.wheels import correction, ramped
from scan3d_twin.protocols.oi_packets import Packet
from scan3d_twin.real.create_link import Values

log = logging.getLogger(__name__)

LEAK = 0.002
"""Share by which the rhythm may be slower than nominal before arrivals correct it; assumption."""
MAX_LAG = 4
"""Periods behind the arrivals after which the rhythm is taken anew."""
MAX_SPEED = 0.6
"""Wheels faster than this are a wrong reading [m/s]; the base does .5."""
SPARE_COUNTS = 10
"""Allowed on top of that [counts]: jitter of the stamps; assumption."""
RESTARTED = 5
"""So many wrong readings in a row, and the base has begun to count anew."""
COMMAND_ERROR = 0.05
"""Of a turn that was only commanded, not measured, standard deviation [rad/rad]; assumption."""


class SampleTimes:
    """Gives every reading the time at which it was measured."""

    def __init__(self, period: float, latency: float) -> None:
        self._period = period
        self._latency = latency
        self._last = -math.inf

    def stamps(self, count: int, now: float) -> list[float]:
        """Return the times [s] of ``count`` readings that had all arrived by ``now``, in order."""
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

    def take(self, stamp: float, values: Values) -> Odometry | None:
        """Return the odometry at ``stamp`` [s]; None if the readings cannot be true."""
        ...

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """Note that from ``stamp`` [s] on the base is told to drive so [m/s, rad/s]."""
        ...


class EncoderReckoning:
    """Odometry from the encoder counts, which are known modulo 2^16 only."""

    def __init__(self, spec: BaseSpec, stamp: float, values: Values) -> None:
        self._counts_per_metre = spec.counts_per_turn / (math.pi * spec.wheel_diameter)
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._total = [0, 0]
        self._raw = self._read(values)
        self._strange: list[int] | None = None
        self._odd = 0
        self._stamp = stamp

    def take(self, stamp: float, values: Values) -> Odometry | None:
        """See ``Reckoning.take``."""
        raw = self._read(values)
        allowed = SPARE_COUNTS + MAX_SPEED * (stamp - self._stamp) * self._counts_per_metre
        steps = _steps(self._raw, raw)
        if max(map(abs, steps)) > allowed:
            if not self._restarted(raw):
                return None
            steps = [0, 0]
        self._raw, self._stamp, self._strange, self._odd = raw, stamp, None, 0
        self._total = [total + step for total, step in zip(self._total, steps, strict=True)]
        return self._reckoning.update(stamp, *self._total)

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """See ``Reckoning.drive``; the encoders know."""

    def _read(self, values: Values) -> list[int]:
        return [values[Packet.LEFT_COUNTS], values[Packet.RIGHT_COUNTS]]

    def _restarted(self, raw: list[int]) -> bool:
        """Tell whether the counts jumped and went on from there."""
        near = self._strange is not None and max(map(abs, _steps(self._strange, raw))) < 64
        self._odd = self._odd + 1 if near else 1
        self._strange = raw
        if self._odd < RESTARTED:
            return False
        log.warning("the base counts its wheels anew: it was switched off and on")
        return True


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
        self._stamp = stamp
        self._speeds = self._told = (0.0, 0.0)
        self._wheel_base = spec.wheel_base
        self._way = self._turn = 0.0
        self._variance = 0.0
        self._read_once = False

    @property
    def unread(self) -> bool:
        """Whether the base has moved since its packets were read."""
        return bool(self._way or self._turn) or not self._read_once

    def take(self, stamp: float, values: Values) -> Odometry:
        """See ``Reckoning.take``."""
        self._advance(stamp)
        if Packet.ANGLE in values:
            if self._read_once:
                self._correct(stamp, values[Packet.DISTANCE], values[Packet.ANGLE])
            self._way = self._turn = 0.0
            self._read_once = True
        return self._odometry(stamp)

    def lost_reading(self) -> None:
        """Note that a reading went astray: what was commanded stands."""
        self._variance += (COMMAND_ERROR * self._turn) ** 2
        self._way = self._turn = 0.0
        self._read_once = True

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """See ``Reckoning.drive``."""
        self._advance(stamp)
        side = angular * self._wheel_base / 2
        self._told = (linear - side, linear + side)

    def _advance(self, stamp: float) -> None:
        """Follow the commands up to ``stamp`` [s], as fast as the wheels can."""
        passed = max(0.0, stamp - self._stamp)
        self._stamp = max(stamp, self._stamp)
        left, right = (
            ramped(speed, told, passed)
            for speed, told in zip(self._speeds, self._told, strict=True)
        )
        self._speeds = (left[1], right[1])
        way, turn = (left[0] + right[0]) / 2, (right[0] - left[0]) / self._wheel_base
        self._way, self._turn = self._way + way, self._turn + turn
        self._reckoning.advance(stamp, way, turn)

    def _correct(self, stamp: float, distance_mm: int, angle_deg: int) -> None:
        """Move by what a reading adds to the commands; at rest that is who pushed the robot."""
        if not (self._way or self._turn or distance_mm or angle_deg):
            return
        way, turn = correction(self._way, self._turn, distance_mm, angle_deg)
        log.debug("corrected by %.1f mm and %.2f deg", 1e3 * way, math.degrees(turn))
        self._reckoning.advance(stamp, way, turn)
        self._variance += math.radians(1.0) ** 2 / 12

    def _odometry(self, stamp: float) -> Odometry:
        plain = self._reckoning.advance(stamp, 0.0, 0.0)
        extra = self._variance + (COMMAND_ERROR * self._turn) ** 2
        covariance = plain.covariance + np.diag([0.0, 0.0, extra])
        return Odometry(stamp, plain.T_odom_base, read_only(covariance))
