"""Poses in the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types.arrays import FloatArray, wrap


@dataclass(frozen=True, slots=True, init=False)
class Pose2:
    """Planar pose ``T_a_b``: position of b's origin in a and b's heading.

    Attributes:
        x: Position along a's x axis [m].
        y: Position along a's y axis [m].
        yaw: Heading, counter-clockwise positive, in [-pi, pi) [rad].

    >>> T_a_b, T_b_c = s3d.Pose2(1.0, 0.0, math.pi / 2), s3d.Pose2(0.5, 0.0, 0.0)
    >>> T_a_c = T_a_b @ T_b_c
    >>> round(T_a_c.x, 9), round(T_a_c.y, 9)
    (1.0, 0.5)
    """

    x: float
    y: float
    yaw: float

    def __init__(self, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
        """Set each field once: there are thousands of poses in a simulated second."""
        put = object.__setattr__
        put(self, "x", float(x))
        put(self, "y", float(y))
        put(self, "yaw", wrap(float(yaw)))

    def __matmul__(self, other: Pose2) -> Pose2:
        """Return ``T_a_c`` from ``T_a_b @ T_b_c``."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            self.yaw + other.yaw,
        )

    def inverse(self) -> Pose2:
        """Return ``T_b_a``."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def apply(self, points: FloatArray) -> FloatArray:
        """Return ``points`` (..., 2 or 3) [m], mapped from b to a; z is kept."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = points[..., 0], points[..., 1]
        result = np.array(points, dtype=np.float64)
        np.subtract(self.x + c * x, s * y, out=result[..., 0])
        np.add(self.y + s * x, c * y, out=result[..., 1])
        return result

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Return the directions ``vectors`` (..., 2 or 3), rotated from b to a."""
        return Pose2(0.0, 0.0, self.yaw).apply(vectors)

    def matrix(self) -> FloatArray:
        """Return the homogeneous transform (4, 4)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array(
            [[c, -s, 0.0, self.x], [s, c, 0.0, self.y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        )

    @staticmethod
    def from_matrix(T: FloatArray) -> Pose2:
        """Return the planar part (x, y, yaw) of a homogeneous transform (4, 4)."""
        return Pose2(float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0]))

    def distance(self, other: Pose2) -> float:
        """Return the distance between the two origins [m]."""
        return math.hypot(self.x - other.x, self.y - other.y)
