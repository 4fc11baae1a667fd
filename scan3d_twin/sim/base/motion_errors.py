"""True motion of a robot without physics, from its commanded path and its wheel errors.

Odometry counts the turns of the wheels. Larger wheels drive farther, two wheels of different size
drive an arc, and a wider wheel base turns less. These are most of the odometry errors in the
physics; the rest is slip and play of the wheels.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import drive_arc
from scan3d_twin.core.types import FloatArray, Pose2, wrap
from scan3d_twin.sim.world import RobotErrors

TURN_CREEP = 0.0022
"""Relative creep of the tyres in a turn on the spot at a friction of 1; inversely proportional to
the friction. Fitted, as the next two, by ``benchmarks/motion_error.py`` (30 robots, 120 moves)."""
SLIP_XY, SLIP_YAW = 0.0009, 0.0011
"""Standard deviations of the rest of a move [m], [rad]: play, and the centre of the turn."""


def turn_scale(errors: RobotErrors) -> float:
    """Return the true angle of a turn on the spot per radian of odometry."""
    scale = float((1 + np.mean(errors.wheel_radius)) / (1 + errors.wheel_base))
    return scale - TURN_CREEP / errors.friction


def apply_motion_errors(
    start: Pose2, path: FloatArray, yaw: float, spec: BaseSpec, errors: RobotErrors
) -> Pose2:
    """Return the true pose, relative to its start, of a robot that followed ``path``.

    Args:
        start: ``T_odom_base`` at the start.
        path: Waypoints (n, 2) in ``odom`` [m], with a turn on the spot at each.
        yaw: Heading in ``odom`` after the last turn [rad].
        spec: The robot's nominal geometry.
        errors: The robot's deviations from it.
    """
    left, right = errors.wheel_radius.tolist()
    scale, base = turn_scale(errors), spec.wheel_base * (1 + errors.wheel_base)
    here, heading, true = (start.x, start.y), start.yaw, Pose2()
    for x, y in path.tolist():
        way = math.hypot(x - here[0], y - here[1])
        bearing = math.atan2(y - here[1], x - here[0]) if way > 0 else heading
        turned = Pose2(0.0, 0.0, scale * wrap(bearing - heading))
        true = (
            true @ turned @ drive_arc(way * (1 + (left + right) / 2), way * (right - left) / base)
        )
        here, heading = (x, y), bearing
    return true @ Pose2(0.0, 0.0, scale * wrap(yaw - heading))
