"""Patterns: the ways to turn the plane of a 2D lidar so that its lines fill space.

The scan plane always holds the axis of the turntable and, at its angle 0, the direction ahead:

* ``yaw-base``: the base turns about its vertical axis, as in the paper; no turntable.
* ``yaw``: a turntable turns a vertical plane about the vertical (A. Nuechter, H. Surmann,
  J. Hertzberg, 6D SLAM).
* ``pitch``: a turntable tips a horizontal plane about the axis to the left (H. Surmann,
  A. Nuechter, J. Hertzberg, An autonomous mobile robot with a 3D laser range finder, 2003).
* ``roll``: a turntable rolls a vertical plane about the axis ahead (T. Ueda et al., 2006).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import PATTERNS
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.types import FloatArray, read_only

AXIS_HEIGHT = 0.30
"""Height of the turntable's axis above the floor [m]: that of the lidar without a turntable."""
LEVER = 0.05
"""Distance of the lidar from the turntable, ahead at its angle 0 [m]: as ahead of the axle without
a turntable; an assumption."""
MAX_LEAN = math.radians(15.0)
"""Angle up to which two directions count as the same [rad]: errors of a mount are smaller."""
_AXES: dict[str, FloatArray] = {
    "yaw": np.eye(3),
    "pitch": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "roll": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
"""Rotation of the frame ``axis`` in ``base``; its z is the direction of the axis."""
_LIDARS: dict[str, FloatArray] = {
    "yaw": np.eye(3),
    "pitch": _AXES["pitch"],
    "roll": np.eye(3),
}
"""Rotation of the lidar in ``base`` at the angle 0."""


@dataclass(frozen=True, eq=False)
class TableMount:
    """Place of a turntable on the base, and of the lidar on the turntable.

    Attributes:
        T_base_axis: Pose of the axis, its z (4, 4).
        T_base_lidar: Pose of the lidar at the turntable's angle 0 (4, 4).
    """

    T_base_axis: FloatArray
    T_base_lidar: FloatArray

    @property
    def T_axis_lidar(self) -> FloatArray:
        """Pose of the lidar in what turns, (4, 4)."""
        return find_axis_mount(self.T_base_axis, self.T_base_lidar)

    def lidar_at(self, angle: float) -> FloatArray:
        """Return ``T_base_lidar`` (4, 4) at an ``angle`` of the turntable [rad]."""
        return turn_lidar(self.T_base_axis, self.T_base_lidar, angle)


def find_mount(pattern: str) -> TableMount | None:
    """Return the designed mount of a turntable for a ``pattern``; None for ``yaw-base``.

    The axis goes through the middle of the base, ``AXIS_HEIGHT`` above the floor.

    Raises:
        UnknownNameError: There is no such pattern.
    """
    if pattern not in PATTERNS:
        raise UnknownNameError("pattern", pattern, PATTERNS)
    if pattern not in _AXES:
        return None
    T_base_axis, T_base_lidar = np.eye(4), np.eye(4)
    T_base_axis[:3, :3], T_base_axis[2, 3] = _AXES[pattern], AXIS_HEIGHT
    T_base_lidar[:3, :3], T_base_lidar[:3, 3] = _LIDARS[pattern], (LEVER, 0.0, AXIS_HEIGHT)
    return TableMount(read_only(T_base_axis), read_only(T_base_lidar))


def find_axis_mount(T_base_axis: FloatArray, T_base_lidar: FloatArray) -> FloatArray:
    """Return ``T_axis_lidar`` (4, 4) of a lidar that is at ``T_base_lidar`` at the angle 0."""
    return np.asarray(np.linalg.inv(T_base_axis) @ T_base_lidar)


def turn_lidar(T_base_axis: FloatArray, T_base_lidar: FloatArray, angle: float) -> FloatArray:
    """Return the pose of the lidar in ``base`` (4, 4) at an ``angle`` of the turntable [rad]."""
    turned = T_base_axis @ rotate_z(angle) @ find_axis_mount(T_base_axis, T_base_lidar)
    return np.asarray(turned)


def rotate_z(angle: float) -> FloatArray:
    """Return the transform (4, 4) of a turn about z by ``angle`` [rad]."""
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    T[:2, :2] = [[c, -s], [s, c]]
    return T


def is_vertical(T_base_axis: FloatArray) -> bool:
    """Return whether a turntable turns about the vertical, but for the error of a mount."""
    return bool(abs(T_base_axis[2, 2]) > math.cos(MAX_LEAN))


def is_ahead(T_base_axis: FloatArray) -> bool:
    """Return whether a turntable turns about the direction ahead rather than that to the left."""
    return bool(abs(T_base_axis[0, 2]) > abs(T_base_axis[1, 2]))


def is_through_middle(T_base_axis: FloatArray) -> bool:
    """Return whether the axis is exactly the vertical one through the middle of the base."""
    column = T_base_axis[:3, 2]
    return bool(column[2] == 1.0 and T_base_axis[0, 3] == 0.0 and T_base_axis[1, 3] == 0.0)


def find_parking_angle(T_base_axis: FloatArray) -> float:
    """Return the angle of a turntable at which its plane is upright, for panoramas by the base.

    A plane that is pitched stands across, with the lidar's front up; others are upright at 0.
    """
    if is_vertical(T_base_axis) or is_ahead(T_base_axis):
        return 0.0
    return -math.pi / 2 if T_base_axis[1, 2] > 0 else math.pi / 2
