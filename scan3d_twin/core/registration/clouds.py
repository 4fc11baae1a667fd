"""Registration of unorganised point clouds, for scans without lines and beams.

Point-to-plane: source points p against planes through the k nearest neighbours of target points
(centroid c, unit normal n), maximum a posteriori as in ``gauss_newton``:

    e = n . (R p + t - c),   J = (n, a x n),  a = R p,
    w = (c^2 / (c^2 + e^2 / s^2))^2 / (2 s^2),

with s the robust spread of the residuals (1.4826 MAD), since the noise of a cloud is not known in
advance. The variance is 2 s^2 because each target point is as noisy, and takes part in as many
pairs as it has neighbours. The normal of a plane fit has the variance s^2 / (k l), with l the
variance along the tangents; the spurious information that it adds is removed as in
``gauss_newton``. The bias of such normals towards the ray is not modelled, so the covariance is a
lower bound; sweeps do better on their grid.

``kd_tree`` finds the neighbours and fits the planes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.algebra import find_determined, invert_information
from scan3d_twin.core.registration.gauss_newton import MIN_PAIRS, Criteria, Dof
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.registration.point_to_plane import (
    MIN_NORMAL_COSINE,
    compute_jacobian,
    spurious_information,
)
from scan3d_twin.core.registration.pose_prior import (
    PLANAR,
    PosePrior,
    displace,
    predict_rmse,
    shift_to_target,
)
from scan3d_twin.core.types import FloatArray, RegistrationResult, read_only

NEIGHBOURS = 20
"""Number of points a plane is fitted to; the default of small_gicp and of PCL's tutorials."""
MIN_POINTS = 50
"""Least number of finite points in a cloud."""
ROBUST_SCALE = 3.0
"""Scale c of the robust kernel, in s; wider than for sweeps, as s includes the outliers."""
MIN_SPREAD = 1e-4
"""Least s [m], so that noise-free clouds keep finite weights."""
GATE_FACTOR = 0.7
"""Factor on the gate from one step to the next."""
FINAL_GATE = 6.0
"""Least gate, in s."""


@dataclass(frozen=True)
class Cloud:
    """Points with the planes through their neighbours.

    Attributes:
        points: Points (n, 3) [m].
        centroids: Centroids of each point's neighbours (n, 3) [m].
        normals: Unit normals towards the origin, which is the viewpoint (n, 3).
        tilt: Variance of each normal per variance of the range noise (n,) [rad2/m2].
        tree: k-d tree of ``points``.
    """

    points: FloatArray
    centroids: FloatArray
    normals: FloatArray
    tilt: FloatArray
    tree: Tree


def prepare_cloud(points: FloatArray) -> Cloud:
    """Fit planes to a cloud (n, 3) [m] seen from its origin; NaN rows are left out.

    Raises:
        ConfigError: The array has another shape.
        RegistrationError: The cloud has too few finite points.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ConfigError(f"a cloud has shape (n, 3), got {points.shape}")
    points = np.ascontiguousarray(points[np.isfinite(points).all(axis=1)])
    if len(points) < MIN_POINTS:
        raise RegistrationError(
            f"the cloud has {len(points)} finite points, {MIN_POINTS} are needed"
        )

    # Fit planes, facing the viewpoint.
    tree = Tree.of(points)
    centroids, normals, variances = tree.fit_planes(NEIGHBOURS)
    normals *= np.where(np.sum(normals * points, axis=1) > 0, -1.0, 1.0)[:, None]
    tilt = 1.0 / (NEIGHBOURS * np.maximum(variances[:, 1] - variances[:, 0], 1e-9))
    return Cloud(points, centroids, normals, tilt, tree)


def register_clouds(
    target: Cloud | FloatArray,
    source: Cloud | FloatArray,
    *,
    init_T_target_source: FloatArray | None = None,
    prior: PosePrior | None = None,
    dof: Dof = "planar",
    criteria: Criteria | None = None,
) -> RegistrationResult:
    """Register the cloud ``source`` to the cloud ``target``.

    Args:
        target: Points (n, 3) [m] seen from their origin, or the result of ``prepare_cloud``.
        source: Points (m, 3) [m] seen from their origin, or the result of ``prepare_cloud``.
        init_T_target_source: Initial guess (4, 4); by default the prior's mean, else identity.
        prior: Prior distribution of the pose; it decides in directions the clouds leave free.
        dof: ``planar`` estimates x, y and theta, ``se3`` all six.
        criteria: Convergence criteria and the first gate.

    Raises:
        ConfigError: A pose or a shape is wrong.
        RegistrationError: A cloud is too small, or the two do not overlap.
    """
    criteria = criteria or Criteria()
    if dof not in ("planar", "se3"):
        raise ConfigError(f"dof must be planar or se3, got {dof!r}")

    # Iterate, tightening the gate.
    pair = _Pair(_as_cloud(target), _as_cloud(source), prior, dof)
    T, gate = _first_guess(init_T_target_source, prior), criteria.max_correspondence_distance
    iterations, settled = 0, False
    while not settled and iterations < criteria.max_iterations:
        step = pair.step(T, gate)
        T = displace(T, step.motion)
        last = FINAL_GATE * step.spread
        settled = gate <= last and _is_small(step.motion, criteria)
        gate, iterations = min(gate, max(last, GATE_FACTOR * gate)), iterations + 1
    return pair.result(T, step, iterations, settled)


def _as_cloud(cloud: Cloud | FloatArray) -> Cloud:
    return cloud if isinstance(cloud, Cloud) else prepare_cloud(cloud)


def _first_guess(init: FloatArray | None, prior: PosePrior | None) -> FloatArray:
    if init is None:
        return np.eye(4) if prior is None else prior.T
    if init.shape != (4, 4) or not np.all(np.isfinite(init)):
        raise ConfigError("init_T_target_source must be a finite (4, 4) transform")
    return init


def _is_small(motion: FloatArray, criteria: Criteria) -> bool:
    return (
        float(np.linalg.norm(motion[:3])) < criteria.translation_epsilon
        and float(np.linalg.norm(motion[3:])) < criteria.rotation_epsilon
    )


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step and its normal equations.

    Attributes:
        motion: Step in x y z rx ry rz about the viewpoint (6,).
        information: Information matrix, less the spurious share (6, 6).
        degenerate: Directions that the clouds do not determine (k, 6).
        pairs: Number of correspondences.
        spread: Robust spread of their residuals [m].
        rmse: RMS of their residuals [m].
    """

    motion: FloatArray
    information: FloatArray
    degenerate: FloatArray
    pairs: int
    spread: float
    rmse: float


@dataclass(frozen=True)
class _Pair:
    """Two clouds to register, the prior, and the estimated entries."""

    target: Cloud
    source: Cloud
    prior: PosePrior | None
    dof: Dof

    def step(self, T: FloatArray, gate: float) -> _Step:
        """Return the Gauss-Newton step at ``T`` (4, 4) from pairs within ``gate`` [m]."""
        # Residuals and robust weights.
        a, n, e, tilt = self._pairs(T, gate)
        scale = max(MIN_SPREAD, 1.4826 * float(np.median(np.abs(e - np.median(e)))))
        w = (ROBUST_SCALE**2 / (ROBUST_SCALE**2 + (e / scale) ** 2)) ** 2 / (2 * scale**2)
        J = compute_jacobian(a.T, n.T)

        # Normal equations and their degeneracy.
        dims = PLANAR if self.dof == "planar" else tuple(range(6))
        rows, block = list(dims), np.ix_(dims, dims)
        H, g = ((J * w) @ J.T)[block], (J @ (w * e))[rows]
        spurious = spurious_information(w * tilt * scale**2, a.T, J)[block]
        reach = math.sqrt(float(np.mean(np.sum(a * a, axis=1))))
        kept, honest, dropped = find_determined(H, spurious, reach)

        # Solve with the prior.
        prior, pull = self._prior(T, dims)
        motion, information = np.zeros(6), np.zeros((6, 6))
        motion[rows] = -invert_information(kept @ H @ kept.T + prior) @ (kept @ g + pull)
        information[block] = honest @ H @ honest.T + prior
        degenerate = np.zeros((len(dropped), 6))
        degenerate[:, rows] = dropped
        return _Step(motion, information, degenerate, len(e), scale, math.sqrt(np.mean(e * e)))

    def _prior(self, T: FloatArray, dims: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the prior's information (k, k) and gradient at ``T`` (k,); 0 without one."""
        if self.prior is None:
            return np.zeros((len(dims), len(dims))), np.zeros(len(dims))
        information = self.prior.information(dims)
        return information, information @ self.prior.deviation(T)[list(dims)]

    def _pairs(self, T: FloatArray, gate: float) -> tuple[FloatArray, ...]:
        """Return lever arms, normals, residuals and normal variances of the correspondences."""
        # Pair with the nearest target point.
        a = self.source.points @ T[:3, :3].T
        moved = a + T[:3, 3]
        square, index = (column[:, 0] for column in self.target.tree.nearest(moved, 1))
        n = self.target.normals[index]
        alike = np.sum(n * (self.source.normals @ T[:3, :3].T), axis=1) > MIN_NORMAL_COSINE
        paired = alike & (square < gate * gate)
        if np.count_nonzero(paired) < MIN_PAIRS:
            raise RegistrationError(
                f"no overlap: only {np.count_nonzero(paired)} pairs of points within {gate:.3g} m, "
                f"{MIN_PAIRS} are needed; give a better init_T_target_source"
            )

        # Residuals along the target's normals.
        index = index[paired]
        e = np.sum(n[paired] * (moved[paired] - self.target.centroids[index]), axis=1)
        return a[paired], n[paired], e, self.target.tilt[index]

    def result(
        self, T: FloatArray, step: _Step, iterations: int, settled: bool
    ) -> RegistrationResult:
        """Return the result at ``T``, with covariances about the target's origin."""
        shift = shift_to_target(T)
        back = np.linalg.inv(shift)
        covariance = invert_information(step.information)
        return RegistrationResult(
            T_target_source=read_only(T),
            covariance=read_only(shift @ covariance @ shift.T),
            information=read_only(back.T @ step.information @ back),
            fitness=step.pairs / len(self.source.points),
            inlier_rmse=step.rmse,
            predicted_rmse=predict_rmse(self.source.points @ T[:3, :3].T, covariance),
            num_inliers=step.pairs,
            iterations=iterations,
            converged=settled,
            degenerate_directions=read_only(step.degenerate @ shift.T),
            ambiguity_gap=1.0,
        )
