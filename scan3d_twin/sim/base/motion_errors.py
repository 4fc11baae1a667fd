"""Where a robot really gets while its odometry says that it turned, drove and turned as told.

Odometry counts turns of the wheels. Wheels that are larger than they should be drive farther, a
pair of two sizes drives an arc, and a wheel base that is wider turns less. That is most of what the
odometry of the physics errs by; what is left is the wheels' slip and play.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.odometry import drive_arc
from scan3d_twin.core.types import FloatArray, Pose2, wrap
from scan3d_twin.sim.world import RobotErrors

CREEP = 0.0022
"""What rubber creeps in a turn on the spot, by the wheels' way, at a friction of 1; it grows with
the reciprocal. As the next two by ``benchmarks/motion_error.py`` (30 robots, 120 moves)."""
SLIP_XY, SLIP_YAW = 0.0009, 0.0011
"""What is left of a move, standard deviations [m], [rad]: play, and where it turns about."""


def turn_scale(errors: RobotErrors) -> float:
    """Return how far a robot turns on the spot for each radian that its odometry tells."""
    scale = float((1 + np.mean(errors.wheel_radius)) / (1 + errors.wheel_base))
    return scale - CREEP / errors.friction


def true_move(
    start: Pose2, path: FloatArray, yaw: float, spec: BaseSpec, errors: RobotErrors
) -> Pose2:
    """Return the true pose, from where it started, of a robot that followed ``path``.

    Args:
        start: ``T_odom_base`` before.
        path: Waypoints (n, 2) in ``odom`` [m] at which it turned on the spot.
        yaw: Heading in ``odom`` to which it turned at the end [rad].
        spec: Its geometry by the data sheet.
        errors: What it is in truth.
    """
    left, right = errors.wheel_radius.tolist()
    scale, base = turn_scale(errors), spec.wheel_base * (1 + errors.wheel_base)
    here, told, true = (start.x, start.y), start.yaw, Pose2()
    for x, y in path.tolist():
        way = math.hypot(x - here[0], y - here[1])
        bearing = math.atan2(y - here[1], x - here[0]) if way > 0 else told
        turned = Pose2(0.0, 0.0, scale * wrap(bearing - told))
        true = (
            true @ turned @ drive_arc(way * (1 + (left + right) / 2), way * (right - left) / base)
        )
        here, told = (x, y), bearing
    return true @ Pose2(0.0, 0.0, scale * wrap(yaw - told))
