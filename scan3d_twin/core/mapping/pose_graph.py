"""Planar pose graph: Gauss-Newton over all poses with full covariances and a graduated kernel.

Poses T_i map view i into the world. An edge states that view j is at Z in view i, up to a small
motion e of covariance C about i's origin, along i's axes, in the order x, y, theta:

    T_i^-1 T_j = Exp(e) Z,    e = Log(T_i^-1 T_j Z^-1),    chi2 = e^T C^-1 e.

Each pose moves along its own axes, T_k <- T_k Exp(d_k), so that

    de/d(d_i) = -Jl^-1(e),   de/d(d_j) = Jl^-1(e) Ad(T_i^-1 T_j),   Jl^-1(e) = I - ad(e) / 2,

up to squares of e. The normal equations (sum J^T w C^-1 J) d = -sum J^T w C^-1 e hold pose 0 fixed.
A wrong edge must not distort the other poses, and poor initial poses must not make a correct loop
closure look wrong. Weights are therefore those of the Geman-McClure kernel, whose width shrinks
from one for which the problem is convex (graduated non-convexity, Yang et al., RA-L 2020),

    w = (mu c^2 / (mu c^2 + chi2))^2,   mu -> 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import FloatArray, IntArray, Pose2, read_only

CHI2_GATE = 16.3
"""chi2 that a correct edge exceeds once in a thousand times, three degrees of freedom."""
KERNEL_SHRINK = 2.0
"""Factor by which the kernel narrows from step to step; Yang et al. use 1.4."""
MAX_STEPS = 100
"""Largest number of Gauss-Newton steps; 10 to 20 are needed."""
UNCONSTRAINED_MESSAGE = "the pose graph leaves a view free to move: add its odometry as an edge"
STEP_TOLERANCE = 1e-7
"""Largest step of a converged solution [m], [rad]."""


@dataclass(frozen=True)
class Solution:
    """The optimised poses, and how well the edges agree with them.

    Attributes:
        poses: ``T_world_i``.
        covariance: Covariance of small motions x, y [m], theta [rad] of all poses along their own
            axes (3 n, 3 n), given pose 0.
        chi2: Squared distance of each edge in standard deviations (m,).
        weights: 1 for an edge that agrees, near 0 for one that contradicts the others (m,).
    """

    poses: tuple[Pose2, ...]
    covariance: FloatArray
    chi2: FloatArray
    weights: FloatArray

    def relative(self, i: int, j: int) -> tuple[Pose2, FloatArray]:
        """Return ``T_i_j`` and its covariance (3, 3) about i's origin, as for an edge."""
        T = self.poses[i].inverse() @ self.poses[j]
        J = np.zeros((3, len(self.covariance)))
        J[:, 3 * i : 3 * i + 3] = -np.eye(3)
        J[:, 3 * j : 3 * j + 3] = adjoint(np.array([[T.x, T.y, T.yaw]]))[0]
        return T, J @ self.covariance @ J.T


class PoseGraph:
    """Poses, and edges between them."""

    def __init__(self, poses: Sequence[Pose2]) -> None:
        """Start with initial poses ``T_world_i``; the first of them stays fixed."""
        self._poses = np.array([[p.x, p.y, p.yaw] for p in poses], dtype=np.float64).reshape(-1, 3)
        self._ends: list[tuple[int, int]] = []
        self._seen: list[tuple[float, float, float]] = []
        self._information: list[FloatArray] = []
        self._robust: list[bool] = []

    def add_edge(
        self, i: int, j: int, T_i_j: Pose2, information: FloatArray, *, robust: bool = True
    ) -> None:
        """Add an edge: an estimate of pose j in i.

        Args:
            i: Index of the pose it is seen from.
            j: Index of the pose that is seen.
            T_i_j: Mean of the estimate.
            information: Information matrix of x, y [m], theta [rad] about i's origin, along i's
                axes (3, 3).
            robust: Whether the edge may be an outlier; odometry is none.

        Raises:
            ConfigError: There is no such pose, or the information is not symmetric and >= 0.
        """
        if i == j or not (0 <= i < len(self._poses) and 0 <= j < len(self._poses)):
            raise ConfigError(f"no edge from pose {i} to {j} among {len(self._poses)} poses")
        W = np.asarray(information, dtype=np.float64)
        if W.shape != (3, 3) or not np.all(np.isfinite(W)) or not np.allclose(W, W.T, rtol=1e-6):
            raise ConfigError("information of an edge must be (3, 3), finite and symmetric")
        if np.linalg.eigvalsh(W)[0] < -1e-9 * abs(W).max():
            raise ConfigError("information of an edge must have no negative eigenvalue")
        self._ends.append((i, j))
        self._seen.append((T_i_j.x, T_i_j.y, T_i_j.yaw))
        self._information.append((W + W.T) / 2)
        self._robust.append(robust)

    def optimize(self) -> Solution:
        """Return the most likely poses.

        Raises:
            ConfigError: The edges do not connect all poses, or leave one free to move.
        """
        # Start with equal weights
        ends = np.array(self._ends, dtype=np.int64).reshape(-1, 2)
        Z, W = np.array(self._seen).reshape(-1, 3), np.array(self._information).reshape(-1, 3, 3)
        robust, X = np.array(self._robust, dtype=bool), self._poses
        X, H, e = _step(X, ends, Z, W, np.ones(len(ends)))

        # Narrow the kernel until convergence
        chi2 = _chi2(X, ends, Z, W)
        width = max(1.0, 2.0 * float(np.max(chi2[robust], initial=0.0)) / CHI2_GATE)
        for _ in range(MAX_STEPS):
            weights = _weights(_chi2(X, ends, Z, W), width, robust)
            X, H, e = _step(X, ends, Z, W, weights)
            if width == 1.0 and e < STEP_TOLERANCE:
                break
            width = max(1.0, width / KERNEL_SHRINK)

        # Judge edges and compute covariances
        chi2 = _chi2(X, ends, Z, W)
        covariance = np.zeros((3 * len(X), 3 * len(X)))
        covariance[3:, 3:] = np.linalg.inv(H)
        return Solution(
            tuple(Pose2(*row) for row in X),
            read_only(covariance),
            read_only(chi2),
            read_only(_weights(chi2, 1.0, robust)),
        )


def _step(
    X: FloatArray, ends: IntArray, Z: FloatArray, W: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return the poses after one Gauss-Newton step, the information matrix and the largest step."""
    # Linearise the edges
    i, j = ends.T
    T_i_j = compose(inverse(X[i]), X[j])
    e = log(compose(T_i_j, inverse(Z)))
    left = np.eye(3) - ad(e) / 2
    J_i, J_j = -left, left @ adjoint(T_i_j)

    # Sum up the normal equations
    W = weights[:, None, None] * W
    H, g = np.zeros((len(X), len(X), 3, 3)), np.zeros((len(X), 3))
    for a, J_a in ((i, J_i), (j, J_j)):
        np.add.at(g, a, np.einsum("mki,mkl,ml->mi", J_a, W, e))
        for b, J_b in ((i, J_i), (j, J_j)):
            np.add.at(H, (a, b), np.einsum("mki,mkl,mlj->mij", J_a, W, J_b))

    # Solve with pose 0 fixed
    full = H.transpose(0, 2, 1, 3).reshape(3 * len(X), 3 * len(X))[3:, 3:]
    try:
        np.linalg.cholesky(full)
    except np.linalg.LinAlgError:
        raise ConfigError(UNCONSTRAINED_MESSAGE) from None
    d = np.zeros((len(X), 3))
    d[1:] = -np.linalg.solve(full, g.reshape(-1)[3:]).reshape(-1, 3)
    return compose(X, exp(d)), full, float(np.max(np.abs(d), initial=0.0))


def _chi2(X: FloatArray, ends: IntArray, Z: FloatArray, W: FloatArray) -> FloatArray:
    """Return the squared distance of each edge in standard deviations (m,)."""
    i, j = ends.T
    e = log(compose(compose(inverse(X[i]), X[j]), inverse(Z)))
    return np.asarray(np.einsum("mi,mij,mj->m", e, W, e))


def _weights(chi2: FloatArray, width: float, robust: FloatArray) -> FloatArray:
    """Return the weight of each edge; ``width`` is mu."""
    kernel = (width * CHI2_GATE / (width * CHI2_GATE + chi2)) ** 2
    return np.where(robust, kernel, 1.0)


def compose(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the poses (n, 3) of T_a T_b."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x, y = c * b[:, 0] - s * b[:, 1], s * b[:, 0] + c * b[:, 1]
    return np.stack([a[:, 0] + x, a[:, 1] + y, _wrap(a[:, 2] + b[:, 2])], axis=1)


def inverse(a: FloatArray) -> FloatArray:
    """Return the inverses (n, 3) of poses."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x, y = -c * a[:, 0] - s * a[:, 1], s * a[:, 0] - c * a[:, 1]
    return np.stack([x, y, -a[:, 2]], axis=1)


def exp(d: FloatArray) -> FloatArray:
    """Return the poses (n, 3) after constant motions d (n, 3) of unit time."""
    theta = d[:, 2]
    sine, versine = np.sinc(theta / math.pi), theta / 2 * np.sinc(theta / math.tau) ** 2
    x, y = sine * d[:, 0] - versine * d[:, 1], versine * d[:, 0] + sine * d[:, 1]
    return np.stack([x, y, _wrap(theta)], axis=1)


def log(T: FloatArray) -> FloatArray:
    """Return the motions (n, 3) whose ``exp`` are the poses T (n, 3)."""
    half = _wrap(T[:, 2]) / 2
    a = np.cos(half) / np.sinc(half / math.pi)
    x, y = a * T[:, 0] + half * T[:, 1], -half * T[:, 0] + a * T[:, 1]
    return np.stack([x, y, 2 * half], axis=1)


def adjoint(T: FloatArray) -> FloatArray:
    """Return Ad(T) (n, 3, 3): T Exp(d) = Exp(Ad(T) d) T."""
    result = np.zeros((len(T), 3, 3))
    c, s = np.cos(T[:, 2]), np.sin(T[:, 2])
    result[:, 0, 0], result[:, 0, 1], result[:, 0, 2] = c, -s, T[:, 1]
    result[:, 1, 0], result[:, 1, 1], result[:, 1, 2] = s, c, -T[:, 0]
    result[:, 2, 2] = 1.0
    return result


def ad(d: FloatArray) -> FloatArray:
    """Return the derivative of Ad(Exp(d)) at rest (n, 3, 3)."""
    result = np.zeros((len(d), 3, 3))
    result[:, 0, 1], result[:, 0, 2] = -d[:, 2], d[:, 1]
    result[:, 1, 0], result[:, 1, 2] = d[:, 2], -d[:, 0]
    return result


def _wrap(angle: FloatArray) -> FloatArray:
    return (angle + math.pi) % math.tau - math.pi
