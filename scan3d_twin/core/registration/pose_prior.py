"""Prior distribution of a pose, small motions of one, and the displacement that they predict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import FloatArray, Pose2, read_only

PLANAR = (0, 1, 5)
"""Rows of x, y and rz in a 6-vector ordered x y z rx ry rz."""
PLANAR_BLOCK = np.ix_(PLANAR, PLANAR)
"""Index of their block in a matrix (6, 6)."""
SIGMA_Z = 0.001
"""Height error of a robot on a floor [m]: the floor's unevenness under three wheels."""
SIGMA_TILT = 0.002
"""Roll and pitch error of a robot on a floor [rad]."""


@dataclass(frozen=True)
class PosePrior:
    """A normal distribution of ``T_target_source`` about the viewpoint, the source's origin.

    Attributes:
        T: Mean (4, 4).
        covariance: Covariance (6, 6) of x, y, z [m] of the source's origin and of rx, ry, rz [rad]
            about it, all along the target's axes.

    >>> prior = s3d.PosePrior.planar(s3d.Pose2(0.0, -0.5, 0.4), sigma_xy=0.02, sigma_yaw=0.03)
    >>> prior.covariance.shape
    (6, 6)
    """

    T: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        if self.T.shape != (4, 4) or not math.isfinite(self.T.sum()):
            raise ConfigError("the prior's pose must be a finite (4, 4) transform")
        C = self.covariance
        if C.shape != (6, 6) or not is_positive_definite(C.tolist()):
            raise ConfigError("the prior's covariance must be (6, 6), finite and positive definite")

    @staticmethod
    def planar(pose: Pose2, sigma_xy: float, sigma_yaw: float) -> PosePrior:
        """Return the prior of a robot on a floor with the same standard deviation in x and y."""
        covariance = np.zeros((3, 3))
        covariance[0, 0] = covariance[1, 1] = sigma_xy**2
        covariance[2, 2] = sigma_yaw**2
        return PosePrior.of_robot(pose, covariance)

    @staticmethod
    def of_robot(pose: Pose2, covariance: FloatArray) -> PosePrior:
        """Return the prior of a robot on a floor with the covariance (3, 3) of x, y and yaw."""
        full = np.zeros((6, 6))
        full[2, 2], full[3, 3], full[4, 4] = SIGMA_Z**2, SIGMA_TILT**2, SIGMA_TILT**2
        full[PLANAR_BLOCK] = covariance
        return PosePrior(read_only(pose.matrix()), read_only(full))

    def information(self, dims: tuple[int, ...]) -> FloatArray:
        """Return the information matrix of ``dims``: the inverse of their covariance."""
        return np.asarray(np.linalg.inv(self.covariance[np.ix_(dims, dims)]), dtype=np.float64)

    def deviation(self, T: FloatArray) -> FloatArray:
        """Return the deviation of ``T`` (4, 4) from the mean, as x y z rx ry rz (6,)."""
        return deviation(T, self.T)


def is_positive_definite(rows: list[list[float]]) -> bool:
    """Return whether a symmetric matrix is finite and positive definite: all pivots are > 0."""
    n = len(rows)
    for k in range(n):
        if not 0.0 < rows[k][k] < math.inf:
            return False
        for i in range(k + 1, n):
            if rows[i][k] == 0.0:
                continue
            factor = rows[i][k] / rows[k][k]
            for j in range(k + 1, n):
                rows[i][j] -= factor * rows[k][j]
    return True


def deviation(T: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the deviation of ``T`` from ``mean``, both (4, 4), as x y z rx ry rz (6,)."""
    off = np.empty(6)
    engine.find_deviation(np.ascontiguousarray(T), np.ascontiguousarray(mean), off)
    return off


def displace(T: FloatArray, step: FloatArray) -> FloatArray:
    """Return ``T`` (4, 4) after motions (..., 6) of the source about its own origin.

    Each motion starts from ``T``; the result has the shape (..., 4, 4).
    """
    moved, steps = np.empty((*step.shape[:-1], 4, 4)), np.ascontiguousarray(step)
    engine.displace(np.ascontiguousarray(T), steps, steps.size // 6, moved)
    return moved


def shift_to_target(T: FloatArray) -> FloatArray:
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

    def turned(self, yaw: float) -> Moments:
        """Return the moments of the points rotated by ``yaw`` [rad] about z."""
        return self.rotated(Pose2(0.0, 0.0, yaw).matrix()[:3, :3])

    def rotated(self, R: FloatArray) -> Moments:
        """Return the moments of the points rotated by ``R`` (3, 3)."""
        return Moments(R @ self.first, R @ self.second @ R.T)


def predict_rmse_of_moments(points: Moments, covariance: FloatArray) -> float:
    """Return the expected RMS displacement [m] of points under a covariance (6, 6).

    E |d + r x p|^2 = tr D + tr S tr M - tr S M + 2 a . E(d x r), with a and M the moments of p and
    D and S the covariances of d and r.

    Args:
        points: Moments relative to the origin that the covariance is about.
        covariance: Covariance of x y z rx ry rz.
    """
    first, second, C = (
        np.ascontiguousarray(part) for part in (points.first, points.second, covariance)
    )
    return float(engine.expect_displacement(first, second, C))


def predict_rmse(points: FloatArray, covariance: FloatArray) -> float:
    """Return the expected RMS displacement [m] of ``points`` (n, 3) under ``covariance`` (6, 6)."""
    return predict_rmse_of_moments(Moments.of(points), covariance)
