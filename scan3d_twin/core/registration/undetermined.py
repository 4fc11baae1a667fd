"""Covariance of poses that the scans leave undetermined in some directions."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.types import FloatArray

MIN_COMPONENT = 0.03
"""Least component along an axis of an undetermined direction: 2 deg, as normals are known."""


def with_infinite_variance(
    covariance: FloatArray, directions: FloatArray, reach: float
) -> FloatArray:
    """Return a covariance (6, 6) with infinite variance along directions (k, 6).

    It is the limit of C + s P for s to infinity, with P the projector onto the directions:
    infinite, with its sign, where P is not 0, and C elsewhere. A slide along a wall that is turned
    against the axes so makes x, y and their covariance infinite. It cannot be multiplied or
    inverted; the information matrix says the same in finite numbers, with 0 along the directions.

    Args:
        covariance: Covariance C of x y z rx ry rz.
        directions: Undetermined directions; components below ``MIN_COMPONENT`` count as 0.
        reach: Length that makes rotations comparable with translations [m].
    """
    if len(directions) == 0:
        return covariance
    unit = np.array([1.0, 1.0, 1.0, reach, reach, reach])
    basis = np.linalg.svd(directions * unit, full_matrices=False)[2]
    projector = basis.T @ basis
    touched = np.diagonal(projector) > MIN_COMPONENT**2
    large = np.abs(projector) > MIN_COMPONENT**2
    return np.where(
        large & np.outer(touched, touched), np.copysign(math.inf, projector), covariance
    )
