"""The motion of a turntable in closed form: pieces of constant acceleration, and the play after it.

What is carried stays where it is until the servo has taken up the play p,

    c(t) = clip(c_0, theta(t) - p / 2, theta(t) + p / 2),

which is exact while the servo turns one way: each piece does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import FloatArray

MIN_TURN = 1e-9
"""Angle below which there is nothing to turn [rad]."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of the motion with one acceleration, in one direction.

    Attributes:
        start: Its time [s].
        angle: Of the servo at its start [rad].
        speed: At its start [rad/s].
        acceleration: [rad/s2].
        carried: Angle of what is carried at its start [rad].
    """

    start: float
    angle: float
    speed: float
    acceleration: float
    carried: float

    def at(self, time: float) -> tuple[float, float]:
        """Return angle [rad] and speed [rad/s] of the servo at ``time`` [s]."""
        t = time - self.start
        angle = self.angle + self.speed * t + self.acceleration / 2 * t * t
        return angle, self.speed + self.acceleration * t


def plan_motion(
    angle: float, speed: float, goal: float, cruise: float, acceleration: float
) -> list[tuple[float, float]]:
    """Return the durations [s] and accelerations [rad/s2] of the motion to rest at ``goal`` [rad].

    Args:
        angle: Where it is [rad].
        speed: How fast it turns there [rad/s].
        goal: Where it is to rest [rad].
        cruise: The largest speed on the way [rad/s].
        acceleration: By which it gets faster and slower [rad/s2].
    """
    steps: list[tuple[float, float]] = []

    # Stop first where the goal would be passed
    stop = angle + speed * abs(speed) / (2 * acceleration)
    if speed != 0.0 and (goal - stop) * speed <= 0.0:
        steps.append((abs(speed) / acceleration, -math.copysign(acceleration, speed)))
        angle, speed = stop, 0.0

    # Accelerate, cruise, brake
    way = goal - angle
    if abs(way) < MIN_TURN:
        return steps
    sign, fast = math.copysign(1.0, way), abs(speed)
    peak = min(cruise, math.sqrt(acceleration * abs(way) + fast * fast / 2))
    change = sign * math.copysign(acceleration, peak - fast)
    steps.append((abs(peak - fast) / acceleration, change))
    changed = abs(peak * peak - fast * fast) / (2 * acceleration)
    left = abs(way) - changed - peak * peak / (2 * acceleration)
    steps.append((max(0.0, left) / peak, 0.0))
    steps.append((peak / acceleration, -sign * acceleration))
    return steps


class Motion:
    """The motion of one turntable, from its start on."""

    def __init__(self, play: float, keep: float) -> None:
        """Rest at 0, in the middle of the play.

        Args:
            play: Between the servo and what it carries [rad].
            keep: Time for which the past is known [s].
        """
        self._play, self._keep = play, keep
        self._pieces = [Piece(-math.inf, 0.0, 0.0, 0.0, 0.0)]
        self._table: FloatArray | None = None

    def servo_at(self, time: float) -> tuple[float, float]:
        """Return angle [rad] and speed [rad/s] of the servo at ``time`` [s], of late."""
        for piece in reversed(self._pieces):
            if piece.start <= time:
                return (piece.angle, 0.0) if math.isinf(piece.start) else piece.at(time)
        return self._pieces[0].angle, 0.0

    def carried_at(self, times: FloatArray) -> FloatArray:
        """Return the angle of what is carried at ``times`` (n,) [s] (n,) [rad]."""
        if self._table is None:
            rows = [(p.start, p.angle, p.speed, p.acceleration, p.carried) for p in self._pieces]
            self._table = np.array(rows)
        table = self._table
        which = np.maximum(0, np.searchsorted(table[:, 0], times, side="right") - 1)
        start, angle, speed, acceleration, carried = table[which].T
        t = np.where(np.isfinite(start), times - np.where(np.isfinite(start), start, 0.0), 0.0)
        servo = angle + speed * t + acceleration / 2 * t * t
        return np.asarray(np.clip(carried, servo - self._play / 2, servo + self._play / 2))

    def turn(self, now: float, goal: float, cruise: float, acceleration: float) -> None:
        """Turn to ``goal`` [rad] from ``now`` [s] on, as ``plan_motion`` does."""
        angle, speed = self.servo_at(now)
        self._follow(now, plan_motion(angle, speed, goal, cruise, acceleration), goal)

    def stop(self, now: float, acceleration: float) -> None:
        """Brake to rest from ``now`` [s] on."""
        angle, speed = self.servo_at(now)
        stop = angle + speed * abs(speed) / (2 * acceleration)
        brake = (abs(speed) / acceleration, -math.copysign(acceleration, speed))
        self._follow(now, [brake] if speed else [], stop)

    def _follow(self, now: float, steps: list[tuple[float, float]], goal: float) -> None:
        """Replace the motion from ``now`` [s] on by ``steps``, and rest at ``goal`` [rad]."""
        # Forget what was planned, and what is long past
        (angle, speed), carried = self.servo_at(now), self._carried_at(now)
        kept = [piece for piece in self._pieces if piece.start < now]
        latest = max(0, sum(piece.start < now - self._keep for piece in kept) - 1)
        self._pieces, self._table = kept[latest:], None

        # Append the new pieces
        for duration, acceleration in steps:
            piece = Piece(now, angle, speed, acceleration, carried)
            self._pieces.append(piece)
            now += duration
            angle, speed = piece.at(now)
            carried = self._clip(carried, angle)
        self._pieces.append(Piece(now, goal, 0.0, 0.0, self._clip(carried, goal)))

    def _carried_at(self, time: float) -> float:
        return float(self.carried_at(np.array([time]))[0])

    def _clip(self, carried: float, angle: float) -> float:
        return min(max(carried, angle - self._play / 2), angle + self._play / 2)
