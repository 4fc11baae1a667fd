"""The motor and the angle sensor of an emulated servo: those of a ``Turntable``."""

from __future__ import annotations

import math

from scan3d_twin.core.hal import Turntable

SPEED_TIME = 0.02
"""Time over which the speed is measured [s]; assumption."""


class Motor:
    """Moves a ``Turntable``, and reads its angle at any time.

    Attributes:
        profile_end: Time at which the latest motion is planned to end [s].
    """

    def __init__(self, turntable: Turntable) -> None:
        self.profile_end = -math.inf
        self._turntable = turntable

    def turn_to(self, angle: float, speed: float, acceleration: float, now: float) -> None:
        """Begin to turn to ``angle`` [rad] at ``now`` [s].

        How it speeds up is up to the turntable; ``acceleration`` [rad/s^2], 0 for a step, says when
        the profile ends.
        """
        distance = abs(angle - self.angle_at(now))
        self.profile_end = now + profile_duration(distance, speed, acceleration)
        self._turntable.turn_to(angle, speed)

    def stop(self) -> None:
        """Stay at the angle that is reached."""
        self.profile_end = -math.inf
        self._turntable.stop()

    def angle_at(self, time: float) -> float:
        """Return the angle at ``time`` [s], between or just beyond the samples [rad]."""
        period = self._turntable.spec.sample_period
        samples = self._turntable.angles_since(time - period)
        if not samples:
            return self._turntable.angle().angle
        after = next((k for k, each in enumerate(samples) if each.stamp > time), len(samples) - 1)
        first, second = samples[max(0, after - 1)], samples[after]
        if second.stamp <= first.stamp:
            return second.angle
        # As the motion went on since the last sample, for one period at most
        share = (min(time, second.stamp + period) - first.stamp) / (second.stamp - first.stamp)
        return first.angle + max(0.0, share) * (second.angle - first.angle)

    def speed_at(self, time: float) -> float:
        """Return the speed before ``time`` [rad/s]."""
        return (self.angle_at(time) - self.angle_at(time - SPEED_TIME)) / SPEED_TIME


def profile_duration(distance: float, speed: float, acceleration: float) -> float:
    """Return how long a trapezoidal profile takes [s].

    Args:
        distance: Way to go from rest to rest [rad].
        speed: Speed in the middle [rad/s].
        acceleration: At both ends [rad/s^2]; 0 is a step of the speed.
    """
    if not acceleration:
        return distance / speed
    ramps = speed**2 / acceleration
    if distance < ramps:
        return 2 * math.sqrt(distance / acceleration)
    return 2 * speed / acceleration + (distance - ramps) / speed
