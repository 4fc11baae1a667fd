"""What is known of a pose before registration, and small motions of one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import FloatArray, Pose2, read_only

PLANAR = (0, 1, 5)
"""Rows of x, y and rz in a 6-vector ordered x y z rx ry rz."""
SIGMA_Z = 0.001
"""A robot on a floor keeps its height [m]: the floor's unevenness under three wheels."""
SIGMA_TILT = 0.001
"""... and stays upright [rad]."""


@dataclass(frozen=True)
class PosePrior:
    """A normal distribution of ``T_target_source`` about the viewpoint, the source's origin.

    Attributes:
        T: Its mean (4, 4).
        covariance: Of x, y, z [m] of the source's origin and of rx, ry, rz [rad] about it, all
            along the target's axes (6, 6).
    """

    T: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        if self.T.shape != (4, 4) or not np.all(np.isfinite(self.T)):
            raise ConfigError("the prior's pose must be a finite (4, 4) transform")
        C = self.covariance
        if C.shape != (6, 6) or not np.all(np.isfinite(C)) or np.linalg.eigvalsh(C)[0] <= 0:
            raise ConfigError("the prior's covariance must be (6, 6), finite and positive definite")

    @staticmethod
    def planar(pose: Pose2, sigma_xy: float, sigma_yaw: float) -> PosePrior:
        """Return the prior of a robot on a floor, with the same error in x and y."""
        return PosePrior.of_robot(pose, np.diag(np.square([sigma_xy, sigma_xy, sigma_yaw])))

    @staticmethod
    def of_robot(pose: Pose2, covariance: FloatArray) -> PosePrior:
        """Return the prior of a robot on a floor with the covariance (3, 3) of x, y and yaw."""
        full = np.diag(np.square([0.0, 0.0, SIGMA_Z, SIGMA_TILT, SIGMA_TILT, 0.0]))
        full[np.ix_(PLANAR, PLANAR)] = covariance
        return PosePrior(read_only(pose.matrix()), read_only(full))

    def information(self, dims: tuple[int, ...]) -> FloatArray:
        """Return the inverse of the covariance of ``dims`` alone."""
        return np.asarray(np.linalg.inv(self.covariance[np.ix_(dims, dims)]), dtype=np.float64)

    def deviation(self, T: FloatArray) -> FloatArray:
        """Return by how much ``T`` (4, 4) lies off the mean (6,), x y z rx ry rz."""
        return np.concatenate([T[:3, 3] - self.T[:3, 3], log_so3(T[:3, :3] @ self.T[:3, :3].T)])


def displaced(T: FloatArray, step: FloatArray) -> FloatArray:
    """Return ``T`` (4, 4) after a small motion (6,) of the source about its own origin."""
    moved = T.copy()
    moved[:3, :3] = exp_so3(step[3:]) @ T[:3, :3]
    moved[:3, 3] += step[:3]
    return moved


def exp_so3(rotation: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    angle = math.sqrt(float(rotation @ rotation))
    x, y, z = rotation
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.asarray(np.eye(3) + K + 0.5 * (K @ K))
    share = (1.0 - math.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + (math.sin(angle) / angle) * K + share * (K @ K))


def log_so3(R: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) of a rotation matrix by less than half a turn."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = math.sqrt(float(axis @ axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(R)) - 1.0))
    return axis if sine < 1e-9 else np.asarray(axis * (angle / sine))


def about_target(T: FloatArray) -> FloatArray:
    """Return the matrix (6, 6) from motions about the source's origin to those about the target's.

    With t the source's origin, d' = d + t x r and r' = r.
    """
    x, y, z = T[:3, 3]
    result = np.eye(6)
    result[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return result


def spread(points: FloatArray, covariance: FloatArray) -> float:
    """Return the expected RMS displacement [m] of points under a covariance (6, 6).

    Args:
        points: Relative to the place the covariance is about (n, 3) [m].
        covariance: In the order x y z rx ry rz.
    """
    M = points.T @ points / len(points)
    a = points.mean(axis=0)
    S, Q = covariance[3:, 3:], covariance[:3, 3:]
    square = float(np.trace(covariance[:3, :3]) + np.trace(S) * np.trace(M) - np.sum(S * M))
    square += 2.0 * float(
        a[2] * (Q[0, 1] - Q[1, 0]) + a[0] * (Q[1, 2] - Q[2, 1]) + a[1] * (Q[2, 0] - Q[0, 2])
    )
    return math.sqrt(max(0.0, square))
