"""Odometry by dead reckoning: the pose and its covariance from the rotation of the wheels."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.types import Odometry, Pose2, read_only

# Variances per metre driven and radian turned. The errors are systematic, so that they grow with
# the distance and not with its root; the figures below hold after 1 m and after 90 deg, for robots
# whose wheel radii err by 0.6 % and whose wheel base errs by 1 % (standard deviations of
# ``RobotErrorConfig``).
_RADIUS, _WHEEL_BASE = 0.006, 0.01
DISTANCE_PER_METRE = _RADIUS**2 / 2
"""Variance of the distance along the path: 0.42 % of 1 m [m^2/m]."""
YAW_PER_METRE = 2 * (_RADIUS / 0.235) ** 2
"""Variance of the heading per distance, wheel base 0.235 m: 2.07 deg in 1 m [rad^2/m]."""
YAW_PER_RADIAN = (_WHEEL_BASE**2 + _RADIUS**2 / 2) * (math.pi / 2)
"""Variance of the heading per turn: 0.98 deg in 90 deg [rad^2/rad]."""

Covariance = tuple[float, ...]
"""Covariance of x, y and yaw: xx, xy, x yaw, yy, y yaw, yaw yaw."""


class DeadReckoning:
    """Odometry from encoder counts, with the base's nominal geometry."""

    def __init__(self, spec: BaseSpec, left: int, right: int) -> None:
        self._metres_per_count = math.pi * spec.wheel_diameter / spec.counts_per_turn
        self._wheel_base = spec.wheel_base
        self._counts = (left, right)
        self._pose = Pose2()
        self._covariance: Covariance = (0.0,) * 6
        self._matrix = read_only(np.zeros((3, 3)))

    def update(self, stamp: float, left: int, right: int) -> Odometry:
        """Return the odometry at ``stamp`` [s] after encoder readings ``left`` and ``right``."""
        left_way = (left - self._counts[0]) * self._metres_per_count
        right_way = (right - self._counts[1]) * self._metres_per_count
        self._counts = (left, right)
        way, turn = (left_way + right_way) / 2, (right_way - left_way) / self._wheel_base
        return self.advance(stamp, way, turn)

    def advance(self, stamp: float, way: float, turn: float) -> Odometry:
        """Return the odometry at ``stamp`` [s] after an arc of ``way`` [m] and ``turn`` [rad]."""
        if way or turn:
            self._covariance = _propagate_covariance(self._covariance, self._pose.yaw, way, turn)
            xx, xy, xt, yy, yt, tt = self._covariance
            self._matrix = np.array([xx, xy, xt, xy, yy, yt, xt, yt, tt]).reshape(3, 3)
            self._matrix.flags.writeable = False
            self._pose = self._pose @ drive_arc(way, turn)
        return Odometry(stamp, self._pose, self._matrix)


def drive_arc(way: float, turn: float) -> Pose2:
    """Return the pose after ``way`` [m] along a circular arc that turns by ``turn`` [rad]."""
    half = turn / 2
    chord = way * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return Pose2(chord * math.cos(half), chord * math.sin(half), turn)


def _propagate_covariance(
    covariance: Covariance, yaw: float, way: float, turn: float
) -> Covariance:
    """Return the covariance of x, y, yaw after one more arc, to first order.

    It is J C J^T plus the variances of the arc, with J the derivative of the new pose with respect
    to the old one. Written out in numbers, as there is an arc every 15 ms and matrices of 3 x 3
    take ten times as long.
    """
    # Differentiate the new pose
    xx, xy, xt, yy, yt, tt = covariance
    c, s = math.cos(yaw + turn / 2), math.sin(yaw + turn / 2)
    a, b = -way * s, way * c

    # Add the variances of the arc
    along = DISTANCE_PER_METRE * abs(way)
    x_yaw, y_yaw = xt + a * tt, yt + b * tt
    return (
        xx + a * xt + a * x_yaw + c * c * along,
        xy + a * yt + b * x_yaw + c * s * along,
        x_yaw,
        yy + b * yt + b * y_yaw + s * s * along,
        y_yaw,
        tt + YAW_PER_METRE * abs(way) + YAW_PER_RADIAN * abs(turn),
    )
