"""What the two wheels of a base do for a command, and what whole numbers tell of it afterwards.

The twin and the driver of the real base share it: a speed that one of them rounds, ramps or
corrects otherwise than the other would be a difference between them that no robot has.
"""

from __future__ import annotations

import math

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import BaseSpec

ACCELERATION = 1.8
"""Of a wheel's rim [m/s^2]; create_robot URDF."""
SPEED_STEP = 0.001
"""Resolution of a wheel's speed [m/s]; opcode 145 takes whole mm/s."""


def wheel_speeds(spec: BaseSpec, linear: float, angular: float) -> tuple[float, float]:
    """Return the (left, right) wheel speeds [m/s] that are sent for a command.

    Too fast a command is slowed down so that the path's curvature is kept; whole mm/s.

    Raises:
        ConfigError: The command is not finite.
    """
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise ConfigError(f"velocity must be finite, got {linear:g} m/s and {angular:g} rad/s")
    left = linear - angular * spec.wheel_base / 2
    right = linear + angular * spec.wheel_base / 2
    scale = min(1.0, spec.max_wheel_speed / max(abs(left), abs(right), SPEED_STEP))
    return (
        round(left * scale / SPEED_STEP) * SPEED_STEP,
        round(right * scale / SPEED_STEP) * SPEED_STEP,
    )


def ramped(speed: float, told: float, time: float) -> tuple[float, float]:
    """Return how far [m] a wheel gets in ``time`` [s], and how fast [m/s] it is then.

    Args:
        speed: Before [m/s].
        told: What it is on its way to [m/s].
        time: [s].
    """
    ramp = min(time, abs(told - speed) / ACCELERATION)
    after = told if ramp < time else speed + math.copysign(ACCELERATION * ramp, told - speed)
    return (speed + after) / 2 * ramp + told * (time - ramp), after


def correction(way: float, turn: float, whole_mm: int, whole_deg: int) -> tuple[float, float]:
    """Return what a Create 1's reading adds to the way [m] and turn [rad] it was commanded.

    Packets 19 and 20 drop the fraction, so a reading says between which two numbers the truth lies;
    the commanded ones are moved no farther than to the nearer of them.
    """
    added_way = 1e-3 * _nearest(1e3 * way, whole_mm) - way
    added_turn = math.radians(_nearest(math.degrees(turn), whole_deg)) - turn
    return added_way, added_turn


def _nearest(value: float, whole: int) -> float:
    """Return the number next to ``value`` whose whole part is ``whole``."""
    low = whole - 1 if whole <= 0 else whole
    high = whole + 1 if whole >= 0 else whole
    return min(max(value, low), high)
