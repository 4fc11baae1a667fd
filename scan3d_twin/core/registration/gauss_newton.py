"""Registration of two sweeps on the grids they were taken on: maximum a posteriori, honestly.

Gauss-Newton on the normal equations of ``point_to_plane``, with the gate and the robust weights
tightened from step to step, the odometry as prior about the viewpoint and vertical edges:

    (H_kept + H_edges + L0) step = -(g_kept + g_edges + L0 (x - x0)).

H_kept holds those eigenvectors v of the scans' information H whose information exceeds twice what
noise of the normals fakes, v^T H v >= 2 v^T H_faked v (Hatleskog and Alexis, arXiv 2410.10784): on
a wall the rest would be a slide that looks like knowledge, so it is left to prior and edges. Twice
means: as much signal as noise. The covariance is the inverse of the left side, less what is faked
and what yaw jitter hides; for point to plane that is sound (Bonnabel et al., arXiv 1410.7632).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.edges import edge_equations
from scan3d_twin.core.registration.point_to_plane import Equations, Gate, linearise
from scan3d_twin.core.registration.pose_prior import (
    PLANAR,
    PosePrior,
    about_target,
    displaced,
    spread,
)
from scan3d_twin.core.registration.surfel_grid import SurfelGrid
from scan3d_twin.core.registration.surfels import X
from scan3d_twin.core.types import FloatArray, IntArray, RegistrationResult, read_only

Dof = Literal["planar", "se3"]
MIN_PAIRS = 12
"""Fewer correspondences than this determine nothing reliably."""
SIGNAL = 2.0
"""A direction is determined when its information is this many times what noise fakes of it."""
WANTED = 3000
"""Surfels used of a source: more add work and no accuracy, as their windows overlap."""
UNKNOWN = 1e-9
"""Share of the largest information below which a direction is taken as unknown."""
TIGHTEN = 0.7
"""Factor of the gate from one step to the next ..."""
LAST_GATE, LAST_ROBUST = 0.03, 1.5
"""... down to these: a few times the range noise, and a robust kernel of 1.5 sigma."""
FIRST_ROBUST = 4.0
"""The kernel of the first step [sigma]."""
EDGE_ROBUST = 2.0
"""The kernel of edges, in kernels of surfels: their errors are uniform, not normal."""


@dataclass(frozen=True, slots=True)
class Criteria:
    """When the iteration ends, and the widest gate."""

    max_iterations: int = 30
    translation_epsilon: float = 2e-5
    rotation_epsilon: float = 2e-5
    max_correspondence_distance: float = 0.10


@dataclass(frozen=True)
class Problem:
    """Two grids and what is known beforehand."""

    target: SurfelGrid
    source: SurfelGrid
    prior: PosePrior | None = None
    dof: Dof = "planar"
    criteria: Criteria = field(default_factory=Criteria)
    thinning: int = 1

    def __post_init__(self) -> None:
        if self.dof not in ("planar", "se3"):
            raise ConfigError(f"dof must be planar or se3, got {self.dof!r}")

    @property
    def dims(self) -> tuple[int, ...]:
        """The estimated entries of x y z rx ry rz."""
        return PLANAR if self.dof == "planar" else (0, 1, 2, 3, 4, 5)

    @cached_property
    def rows(self) -> IntArray:
        """``dims`` as an index."""
        return np.array(self.dims)

    @cached_property
    def block(self) -> tuple[IntArray, IntArray]:
        """Index of the rows and columns of ``dims`` of a matrix (6, 6)."""
        return self.rows[:, None], self.rows[None, :]

    @cached_property
    def L0(self) -> FloatArray:  # noqa: N802
        """Information (k, k) of the prior on the estimated entries; 0 without one."""
        if self.prior is None:
            return np.zeros((len(self.dims), len(self.dims)))
        return self.prior.information(self.dims)

    def deviation(self, T: FloatArray) -> FloatArray:
        """Return by how much ``T`` lies off the prior's mean on the estimated entries (k,)."""
        if self.prior is None:
            return np.zeros(len(self.dims))
        return np.asarray(self.prior.deviation(T)[list(self.dims)])

    @cached_property
    def yaw_scale_information(self) -> float:
        """Of the common relative error of the yaws; infinite when they are taken as exact."""
        sigma = max(self.target.noise.yaw_scale_sigma, self.source.noise.yaw_scale_sigma)
        return 1.0 / sigma**2 if sigma > 0 else math.inf

    @cached_property
    def stride(self) -> int:
        """Of the source's surfels in the last steps: 2 to 4, times ``thinning``."""
        return self.thinning * min(4, max(2, round(math.sqrt(self.source.count / WANTED))))

    @cached_property
    def reach(self) -> float:
        """Root mean square distance of the source's surfels [m]: makes turns lengths."""
        rows = self.source.sample(self.stride).rows[:, X]
        return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


@dataclass(frozen=True)
class State:
    """Where the iteration stands: ``T_target_source`` (4, 4) and the yaw scale error."""

    T: FloatArray
    scale: float = 0.0


@dataclass(frozen=True)
class Solution:
    """One Gauss-Newton step and what is known there.

    Attributes:
        step: Of x y z rx ry rz about the viewpoint (6,).
        scale_step: Of the yaw scale error.
        information: Left side of the equation, less what is faked (k, k).
        degenerate: Directions (j, k) that neither scans nor edges determine.
        equations: Of the scans.
    """

    step: FloatArray
    scale_step: float
    information: FloatArray
    degenerate: FloatArray
    equations: Equations


def align(problem: Problem, init: FloatArray) -> tuple[State, Solution, int, bool]:
    """Return the last state, the solution there, the iterations run and whether they settled.

    Raises:
        RegistrationError: The scans do not overlap at ``init``, or lost each other on the way.
    """
    state, criteria = State(init), problem.criteria
    for iteration in range(criteria.max_iterations):
        gate = _gate(iteration, criteria)
        final = gate.distance <= LAST_GATE and gate.robust <= LAST_ROBUST
        stride = problem.stride if final else 2 * problem.stride
        solution = solve(problem, state, stride, gate)
        state = State(displaced(state.T, solution.step), state.scale + solution.scale_step)
        settled = (
            float(np.linalg.norm(solution.step[:3])) < criteria.translation_epsilon
            and float(np.linalg.norm(solution.step[3:])) < criteria.rotation_epsilon
        )
        if final and settled:
            return state, solution, iteration + 1, True
    return state, solution, criteria.max_iterations, False


def _gate(iteration: int, criteria: Criteria) -> Gate:
    tight = TIGHTEN**iteration
    widest = criteria.max_correspondence_distance
    return Gate(max(min(LAST_GATE, widest), tight * widest), max(LAST_ROBUST, FIRST_ROBUST * tight))


def solve(problem: Problem, state: State, stride: int, gate: Gate) -> Solution:
    """Return the Gauss-Newton step at ``state``; the equation is at the module's head."""
    equations = linearise(problem.target, problem.source, stride, state.T, state.scale, gate)
    if equations.pairs < MIN_PAIRS:
        raise RegistrationError(
            f"no overlap: only {equations.pairs} pairs of surfels within {gate.distance:g} m, "
            f"{MIN_PAIRS} are needed; give a better init_T_target_source"
        )
    H, g, per_step = without_scale(equations, problem.yaw_scale_information, state.scale)
    dims, block = problem.rows, problem.block
    H, g, faked = H[block], g[dims], equations.faked[block]
    seen = equations.information[block]
    kept, honest, dropped = determined(seen, faked, problem.reach, problem.dof)
    H_edges, g_edges = edge_equations(
        problem.target.edges,
        problem.source.edges,
        state.T,
        gate.distance,
        EDGE_ROBUST * gate.robust,
    )
    H_edges, g_edges = H_edges[block], g_edges[dims]
    others = H_edges + problem.L0
    left = kept @ H @ kept.T + others
    right = kept @ g + g_edges + problem.L0 @ problem.deviation(state.T)
    step = np.zeros(6)
    step[dims] = -_inverse(problem, left) @ right
    free = np.array([v for v in dropped if v @ H_edges @ v <= v @ problem.L0 @ v])
    scale_step = 0.0 if per_step is None else float(per_step[0] + per_step[1:] @ step)
    return Solution(
        step, scale_step, honest @ H @ honest.T + others, free.reshape(-1, len(dims)), equations
    )


def _inverse(problem: Problem, information: FloatArray) -> FloatArray:
    """Return the inverse (k, k); without a prior, 0 on the directions that nothing determines."""
    if problem.prior is not None:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    inverse = np.linalg.pinv(information, rcond=UNKNOWN, hermitian=True)
    return np.asarray(inverse, dtype=np.float64)


def without_scale(
    equations: Equations, prior: float, scale: float
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Eliminate the yaw scale by its Schur complement.

    Returns:
        Information (6, 6) and gradient (6,) of the pose, and the scale's step as an affine function
        of the pose's (7,); None when the scale is taken as exact.
    """
    H, g = equations.information - equations.lost, equations.gradient
    if math.isinf(prior):
        return H[:6, :6], g[:6], None
    own, right = H[6, 6] + prior, g[6] + prior * scale
    cross = H[:6, 6]
    affine = -np.concatenate([[right], cross]) / own
    return H[:6, :6] - np.outer(cross, cross) / own, g[:6] - cross * (right / own), affine


def determined(
    H: FloatArray, faked: FloatArray, reach: float, dof: Dof
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tell which directions the scans determine.

    Args:
        H: Information of the scans (k, k).
        faked: What noise of the normals fakes of it (k, k).
        reach: Length that makes turns comparable with shifts [m].
        dof: Which entries the rows are.

    Returns:
        The projector K (k, k) such that K H K^T and K g keep the determined directions, the same
        with each shortened by the root of the share that is not faked (k, k), and the others as
        unit rows (j, k).
    """
    turns = 1 if dof == "planar" else 3
    unit = np.ones(len(H))
    unit[-turns:] = 1.0 / reach
    metric = unit[:, None] * unit
    values, vectors = np.linalg.eigh(H * metric)
    noise = np.sum(vectors * ((faked * metric) @ vectors), axis=0)
    good = (values > 0) & (values >= SIGNAL * np.maximum(noise, 1e-12 * values[-1]))
    V, scaling = vectors[:, good], unit / unit[:, None]
    share = np.sqrt(1.0 - noise[good] / values[good])
    dropped = (vectors[:, ~good] * unit[:, None]).T
    dropped /= np.sqrt(np.sum(dropped * dropped, axis=1, keepdims=True))
    return (
        (V @ V.T) * scaling,
        (V * share) @ V.T * scaling,
        dropped,
    )


def report(
    problem: Problem,
    state: State,
    solution: Solution,
    iterations: int,
    settled: bool,
    ambiguity_gap: float,
) -> RegistrationResult:
    """Return the result for the last state, with covariances about the target's origin."""
    dims, equations = list(problem.dims), solution.equations
    sample = problem.source.sample(problem.stride)
    covariance, information = np.zeros((6, 6)), np.zeros((6, 6))
    covariance[np.ix_(dims, dims)] = _inverse(problem, solution.information)
    information[np.ix_(dims, dims)] = solution.information
    degenerate = np.zeros((len(solution.degenerate), 6))
    degenerate[:, dims] = solution.degenerate
    shift = about_target(state.T)
    back = np.linalg.inv(shift)
    return RegistrationResult(
        T_target_source=read_only(state.T),
        covariance=read_only(shift @ covariance @ shift.T),
        information=read_only(back.T @ information @ back),
        fitness=equations.pairs / len(sample.rows),
        inlier_rmse=math.sqrt(equations.square / equations.pairs),
        predicted_rmse=spread(sample.rows[:, X] @ state.T[:3, :3].T, covariance),
        num_inliers=equations.pairs,
        iterations=iterations,
        converged=settled,
        degenerate_directions=read_only(degenerate @ shift.T),
        ambiguity_gap=ambiguity_gap,
    )
