"""Kinematics of the two wheels: speeds for a command, ramps, and readings in whole numbers.

The twin and the driver of the real base share these functions, so that both round, ramp and correct
speeds in the same way.
"""

from __future__ import annotations

import math

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import BaseSpec

WHEEL_ACCELERATION = 1.8
"""Acceleration of a wheel's rim [m/s^2]; create_robot URDF."""
SPEED_STEP = 0.001
"""Resolution of a wheel's speed [m/s]; opcode 145 takes whole mm/s."""


def split_velocity(spec: BaseSpec, linear: float, angular: float) -> tuple[float, float]:
    """Return the (left, right) wheel speeds [m/s] that are sent for a command, in whole mm/s.

    A command that is too fast is slowed down so that the curvature of the path is kept; one that is
    too slow for the wheels to turn (``min_wheel_speed``) is sped up in the same way.

    Raises:
        ConfigError: The command is not finite.
    """
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise ConfigError(f"velocity must be finite, got {linear:g} m/s and {angular:g} rad/s")
    left = linear - angular * spec.wheel_base / 2
    right = linear + angular * spec.wheel_base / 2
    fastest = max(abs(left), abs(right))
    scale = min(1.0, spec.max_wheel_speed / max(fastest, SPEED_STEP))
    if SPEED_STEP / 2 < fastest < spec.min_wheel_speed:
        scale = spec.min_wheel_speed / fastest
    return (
        round(left * scale / SPEED_STEP) * SPEED_STEP,
        round(right * scale / SPEED_STEP) * SPEED_STEP,
    )


def ramp_speed(speed: float, target: float, time: float) -> tuple[float, float]:
    """Return the distance [m] that a wheel moves in ``time`` [s], and its speed then [m/s].

    Args:
        speed: Speed at the start [m/s].
        target: Commanded speed, which it approaches at ``WHEEL_ACCELERATION`` [m/s].
        time: Duration [s].
    """
    ramp = min(time, abs(target - speed) / WHEEL_ACCELERATION)
    step = math.copysign(WHEEL_ACCELERATION * ramp, target - speed)
    after = target if ramp < time else speed + step
    return (speed + after) / 2 * ramp + target * (time - ramp), after


def correct_reading(way: float, turn: float, whole_mm: int, whole_deg: int) -> tuple[float, float]:
    """Return the corrections of a commanded distance [m] and turn [rad] by a Create 1's reading.

    Packets 19 and 20 drop the fraction, so that a reading is an interval of one unit. A commanded
    value outside of it is moved to the nearer end.

    Args:
        way: Commanded distance [m].
        turn: Commanded turn [rad].
        whole_mm: Distance of packet 19 [mm].
        whole_deg: Angle of packet 20 [deg].
    """
    added_way = 1e-3 * _clamp_to_whole(1e3 * way, whole_mm) - way
    added_turn = math.radians(_clamp_to_whole(math.degrees(turn), whole_deg)) - turn
    return added_way, added_turn


def _clamp_to_whole(value: float, whole: int) -> float:
    """Return the number next to ``value`` whose whole part is ``whole``."""
    low = whole - 1 if whole <= 0 else whole
    high = whole + 1 if whole >= 0 else whole
    return min(max(value, low), high)
