"""Dead reckoning of a real Create: from encoder counts, or on a Create 1 from drive commands.

Timestamps: the base samples its sensors every 15 ms, but the bytes arrive with jitter, in bursts
or late. The earliest arrivals show the true sampling times.
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
"""Relative clock drift allowed: stamps advance by at most (1 + LEAK) periods; assumption."""
MAX_LAG = 4
"""Lag of the stamps behind the arrivals at which they are synchronised again [periods]."""
MAX_SPEED = 0.6
"""Wheel speed beyond which a reading must be wrong [m/s]; the base reaches 0.5 m/s."""
TOLERANCE_COUNTS, TOLERANCE_SHARE = 10, 0.15
"""Tolerance around the commanded motion [counts, and share of the distance]: for the jitter of the
stamps and for wheels that follow their command with a delay; assumption."""
RESTART_AFTER = 20
"""Impossible readings in a row (0.3 s) after which the counters must have been reset."""
COMMAND_ERROR = 0.05
"""Standard deviation of a rotation that was commanded but not measured [rad/rad]; assumption."""


class SampleTimes:
    """Estimates the time at which each reading was sampled from the time at which it arrived."""

    def __init__(self, period: float, latency: float) -> None:
        self._period = period
        self._latency = latency
        self._last = -math.inf

    def stamps(self, count: int, now: float, *, gap: bool = False) -> list[float]:
        """Return the sampling times [s] of ``count`` readings that have arrived by ``now``.

        Args:
            count: Number of readings.
            now: Current time [s].
            gap: Whether readings were lost before these, so that only their arrival is known.
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
    """Turns readings into odometry."""

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry | None:
        """Return the odometry at ``stamp``; None if the readings are rejected or unconfirmed.

        Args:
            stamp: Time at which they were sampled [s].
            values: The readings.
            doubtful: Whether the link is noisy, so that the readings may be wrong.
        """
        ...

    def drive(self, stamp: float, linear: float, angular: float) -> None:
        """Record the velocity [m/s, rad/s] that is commanded from ``stamp`` [s] on."""
        ...


class CommandedWheels:
    """Predicted wheel motion: the commanded speeds, with the acceleration the wheels can reach."""

    def __init__(self, spec: BaseSpec, stamp: float) -> None:
        self._wheel_base = spec.wheel_base
        self._stamp = stamp
        self._speeds = self._commanded = (0.0, 0.0)

    def drive(self, linear: float, angular: float) -> None:
        """Set the commanded velocity [m/s, rad/s] from the time of the last ``advance`` on."""
        side = angular * self._wheel_base / 2
        self._commanded = (linear - side, linear + side)

    def advance(self, stamp: float) -> tuple[float, float]:
        """Advance to ``stamp`` [s]; return the distances the (left, right) wheel moved [m]."""
        passed = max(0.0, stamp - self._stamp)
        self._stamp = max(stamp, self._stamp)
        left, right = (
            ramp_speed(speed, commanded, passed)
            for speed, commanded in zip(self._speeds, self._commanded, strict=True)
        )
        self._speeds = (left[1], right[1])
        return left[0], right[0]


class EncoderReckoning:
    """Odometry from the encoder counts, which wrap at 2^16.

    A reading far from the commanded motion is an outlier. It is accepted when the next reading
    continues from it: a wheel is blocked, or the robot was pushed. Counts that no wheel can reach
    are accepted as a new origin after ``RESTART_AFTER`` such readings in a row: the base was
    switched off and on.
    """

    def __init__(self, spec: BaseSpec, stamp: float, values: Values) -> None:
        self._counts_per_metre = spec.counts_per_turn / (math.pi * spec.wheel_diameter)
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._wheels = CommandedWheels(spec, stamp)
        self._expected = [0.0, 0.0]
        self._total = [0, 0]
        self._raw = self._read(values)
        self._outlier: tuple[float, list[int]] | None = None
        self._outlier_count = 0
        self._stamp = stamp

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry | None:
        """See ``Reckoning.take``."""
        # Compare with the prediction
        raw = self._read(values)
        self._advance(stamp)
        steps = _steps(self._raw, raw)
        if not self._matches_commands(steps):
            confirmed = self._continues_outlier(stamp, raw)
            self._outlier = (stamp, raw)
            if not self._is_reachable(steps, stamp - self._stamp):
                if self._outlier_count < RESTART_AFTER:
                    return None
                log.warning("the base has reset its encoder counts: it was switched off and on")
                steps = [0, 0]
            elif not confirmed:
                return None
        else:
            self._outlier, self._outlier_count = None, 0

        # Accept the reading
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

    def _matches_commands(self, steps: list[int]) -> bool:
        """Return whether ``steps`` [counts] agree with the commanded motion."""
        return all(
            abs(step - expected) <= TOLERANCE_COUNTS + TOLERANCE_SHARE * abs(expected)
            for step, expected in zip(steps, self._expected, strict=True)
        )

    def _is_reachable(self, steps: list[int], passed: float) -> bool:
        """Return whether wheels can turn by ``steps`` [counts] in the time ``passed`` [s]."""
        return (
            max(map(abs, steps)) <= TOLERANCE_COUNTS + MAX_SPEED * passed * self._counts_per_metre
        )

    def _continues_outlier(self, stamp: float, raw: list[int]) -> bool:
        """Return whether ``raw`` continues the outlier before it; count the outliers in a row."""
        near = False
        if self._outlier is not None:
            before, counts = self._outlier
            near = self._is_reachable(_steps(counts, raw), stamp - before)
        self._outlier_count = self._outlier_count + 1 if near else 1
        return near


def _steps(before: list[int], after: list[int]) -> list[int]:
    """Return the signed steps between counters that wrap at 2^16; unambiguous up to 14 m."""
    return [((b - a + 32768) & 0xFFFF) - 32768 for a, b in zip(before, after, strict=True)]


class CommandedReckoning:
    """Odometry of a Create 1, which has no encoder counts.

    Its packets 19 and 20 hold whole mm and degrees since the last read, and each read drops the
    fraction: read every 15 ms, a slow turn would be 0. The pose therefore follows the commanded
    speeds, and the packets are read only at rest. A reading bounds the true motion from both
    sides; where the commanded motion lies outside, it is moved to the nearer bound.
    """

    def __init__(self, spec: BaseSpec, stamp: float) -> None:
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._wheels = CommandedWheels(spec, stamp)
        self._wheel_base = spec.wheel_base
        self._distance = self._rotation = 0.0
        self._variance = 0.0
        self._read_once = False

    @property
    def unread(self) -> bool:
        """Whether the base has moved since packets 19 and 20 were last read."""
        return bool(self._distance or self._rotation) or not self._read_once

    def take(self, stamp: float, values: Values, *, doubtful: bool = False) -> Odometry:
        """See ``Reckoning.take``; a doubtful reading is ignored in favour of the commands."""
        self._advance(stamp)
        if Packet.ANGLE in values:
            if doubtful:
                self._variance += (COMMAND_ERROR * self._rotation) ** 2
            elif self._read_once:
                self._correct(stamp, values[Packet.DISTANCE], values[Packet.ANGLE])
            self._distance = self._rotation = 0.0
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
        self._distance, self._rotation = self._distance + way, self._rotation + turn
        self._reckoning.advance(stamp, way, turn)

    def _correct(self, stamp: float, distance_mm: int, angle_deg: int) -> None:
        """Correct the commanded motion by a reading; without commands, the robot was pushed."""
        if not (self._distance or self._rotation or distance_mm or angle_deg):
            return
        way, turn = correct_reading(self._distance, self._rotation, distance_mm, angle_deg)
        log.debug("corrected by %.1f mm and %.2f deg", 1e3 * way, math.degrees(turn))
        self._reckoning.advance(stamp, way, turn)
        self._variance += math.radians(1.0) ** 2 / 12

    def _odometry(self, stamp: float) -> Odometry:
        plain = self._reckoning.advance(stamp, 0.0, 0.0)
        extra = self._variance + (COMMAND_ERROR * self._rotation) ** 2
        covariance = plain.covariance + np.diag([0.0, 0.0, extra])
        return Odometry(stamp, plain.T_odom_base, read_only(covariance))


def make_reckoning(spec: BaseSpec, stamp: float, values: Values) -> Reckoning:
    """Return the ``Reckoning`` for a base that sends ``values``, at rest at ``stamp`` [s]."""
    if Packet.LEFT_COUNTS in values:
        return EncoderReckoning(spec, stamp, values)
    return CommandedReckoning(spec, stamp)
