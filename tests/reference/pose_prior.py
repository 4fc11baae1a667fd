"""Small motions of a pose, its deviation from another, and expected displacements."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.types import FloatArray


def deviation(T: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the deviation of ``T`` from ``mean``, both (4, 4), as x y z rx ry rz (6,)."""
    R, result = np.zeros((3, 3)), np.empty(6)
    for i in range(3):
        result[i] = T[i, 3] - mean[i, 3]
        for j in range(3):
            for k in range(3):
                R[i, j] += T[i, k] * mean[j, k]
    result[3:] = log_so3(R)
    return result


def displaced(T: FloatArray, step: FloatArray) -> FloatArray:
    """Return ``T`` (4, 4) after a small motion (6,) of the source about its own origin."""
    R, moved = exp_so3(step[3:]), T.copy()
    for i in range(3):
        moved[i, 3] += step[i]
        for j in range(3):
            moved[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
    return moved


def exp_so3(rotation: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    x, y, z = rotation[0], rotation[1], rotation[2]
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    small = angle < 1e-8
    c = math.cos(angle)
    s = 1.0 if small else math.sin(angle) / angle
    v = 0.5 if small else (1.0 - c) / square
    return np.array(
        [
            [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
        ]
    )


def log_so3(R: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) of a rotation matrix by less than half a turn."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    return axis if sine < 1e-9 else axis * (angle / sine)


def about_target(T: FloatArray) -> FloatArray:
    """Return the matrix (6, 6) that takes motions about the source's origin to the target's.

    With t the source's origin, d' = d + t x r and r' = r.
    """
    result = np.eye(6)
    result[0, 4], result[1, 3] = -T[2, 3], T[2, 3]
    result[0, 5], result[2, 3] = T[1, 3], -T[1, 3]
    result[1, 5], result[2, 4] = -T[0, 3], T[0, 3]
    return result


class Moments(NamedTuple):
    """First and second moment of points p: the means of p (3,) and of p p^T (3, 3)."""

    first: FloatArray
    second: FloatArray

    @staticmethod
    def of(points: FloatArray) -> Moments:
        """Return the moments of ``points`` (n, 3)."""
        return Moments(points.sum(axis=0) / len(points), points.T @ points / len(points))


def displacement(points: Moments, covariance: FloatArray) -> float:
    """Return the root of E |d + r x p|^2 = tr D + tr S tr M - tr S M + 2 a . E(d x r) [m]."""
    a, M, square = points.first, points.second, 0.0
    for i in range(3):
        square += covariance[i, i]
        for j in range(3):
            square += covariance[3 + i, 3 + i] * M[j, j] - covariance[3 + i, 3 + j] * M[j, i]
    square += 2.0 * a[2] * (covariance[0, 4] - covariance[1, 3])
    square += 2.0 * a[0] * (covariance[1, 5] - covariance[2, 4])
    square += 2.0 * a[1] * (covariance[2, 3] - covariance[0, 5])
    return math.sqrt(max(0.0, square))
