"""Alignment of two unorganised clouds from one start: the pose at rest and its covariance.

Pairs of patches (``pairs``) give symmetric point-to-plane residuals; Gauss-Newton with a
robust kernel moves the source, coarse to fine.

**Coarse to fine.** From the coarsest level that still shows objects down to the finest, with a gate
that shrinks to three sides of a cell. The scale of the kernel is the spread of the residuals, which
still hold the misalignment. No direction is dropped: damping holds those without information.

**Last level.** Each patch takes part at the finest level at which it is flat. The scale of the
kernel is the standard deviation of the residual by the patches' own noise, times the spread of the
standardised residuals, at least 1. Windows overlap, so that a pair carries only the information of
the points of its cell: its weight is 1 / (v_s / f_s + v_t / f_t), with v the variances by source
and target and f the points of a cell per point of a window.

**Degeneracy.** J_s and J_t, by the normal of the source and of the target, have independent errors,
so that J_s J_t^T has no spurious part where J J^T has one. The sum of w D D^T with
D = (J_s - J_t) / 2 is their difference: what noise, curvature and lateral offsets fake. A direction
v counts as determined if v^T H v >= 2 v^T H_spurious v, as for sweeps (``gauss_newton``), and this
is asked only once the iteration has come to rest. What both clouds share is not seen by it, such as
a bias of normals towards rays that come the same way.

**Undetermined directions** follow the prior. Without one they stay as guessed, and their variance
is infinite (``undetermined``), as is ``predicted_rmse``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.registration.algebra import find_determined, invert_information
from scan3d_twin.core.registration.clouds.pairs import (
    DIFFERENCE,
    JACOBIAN,
    MIN_SPREAD,
    PAIR,
    RESIDUAL,
    SOURCE_VARIANCE,
    TARGET_VARIANCE,
    pair_patches,
    robust_spread,
    standardise,
    weigh,
)
from scan3d_twin.core.registration.clouds.patches import Cloud, Level
from scan3d_twin.core.registration.gauss_newton import MIN_PAIRS, Criteria, Dof
from scan3d_twin.core.registration.pose_prior import (
    PLANAR,
    PosePrior,
    deviation,
    displace,
    predict_rmse_of_moments,
    shift_to_target,
)
from scan3d_twin.core.registration.undetermined import with_infinite_variance
from scan3d_twin.core.types import FloatArray, RegistrationResult, read_only

WIDEST_GATE = 2.0
"""Widest first gate [m]; smaller for small clouds."""
WIDEST_SHARE = 0.5
"""Widest first gate, in the RMS radius of the target: a guess off by more is no guess."""
PRIOR_GATE = 3.0
"""First gate, in the RMS displacement of the source that the prior expects."""
GATE_FACTOR = 0.7
"""Factor on the gate from one coarse step to the next."""
COARSE_GATE, LAST_GATE = 3.0, 2.0
"""Least gate of the coarse steps and gate of the last ones, in sides of a cell."""
COARSE_STEPS = 15
"""Most steps on a coarse level."""
COARSEST = 0.5
"""Largest gate of the coarsest level in use, in the first gate: larger cells show no objects."""
COARSE_MOTION = 0.1
"""Motion below which a coarse level has converged, in sides of a cell."""
INLIER = 3.0
"""Largest residual of an inlier, in spreads."""
DAMPING = 1e-3
"""Damping of the coarse steps, as a share of the largest information."""


@dataclass(frozen=True)
class _Share:
    """The patches of one level of the source that take part in the last steps.

    Attributes:
        level: Level of the target to pair with.
        patches: Patches of the source (k, PATCH).
        fractions: Share of the points of each cell that counts, 0..1 (k,).
        own_share: Points of a cell per point of a window, of the source.
    """

    level: Level
    patches: FloatArray
    fractions: FloatArray
    own_share: float


@dataclass(frozen=True)
class _Equations:
    """Pairs of the last level, weighted.

    Attributes:
        pairs: Pairs (m, PAIR).
        weights: Robust information of each pair (m,) [1/m2].
        spread: Spread of the residuals, in the standard deviations expected of them; at least 1.
    """

    pairs: FloatArray
    weights: FloatArray
    spread: float

    @property
    def residuals(self) -> FloatArray:
        """Distances along the mean normals (m,) [m]."""
        return self.pairs[:, RESIDUAL]


@dataclass(frozen=True)
class CloudAlignment:
    """Two clouds to register, the prior, and the options."""

    target: Cloud
    source: Cloud
    prior: PosePrior | None
    dof: Dof
    criteria: Criteria | None

    @property
    def dims(self) -> tuple[int, ...]:
        """The estimated entries of x y z rx ry rz."""
        return PLANAR if self.dof == "planar" else (0, 1, 2, 3, 4, 5)

    @cached_property
    def finest(self) -> int:
        """Exponent of the finest level that both clouds have."""
        return max(self.target.finest, self.source.finest)

    @property
    def coarsest(self) -> int:
        """Exponent of the coarsest level that both clouds have."""
        return min(self.target.coarsest, self.source.coarsest)

    @cached_property
    def reach(self) -> float:
        """RMS distance of the source's points from its origin [m]."""
        return math.sqrt(float(np.trace(self.source.moments.second)))

    @property
    def first_gate(self) -> float:
        """Gate of the first step [m]."""
        if self.criteria is not None:
            return self.criteria.max_correspondence_distance
        widest = min(WIDEST_GATE, WIDEST_SHARE * self.target.radius)
        if self.prior is None:
            return widest
        points = self.source.moments.rotated(self.prior.T[:3, :3])
        return min(widest, PRIOR_GATE * predict_rmse_of_moments(points, self.prior.covariance))

    # --- coarse to fine ---

    def align_coarsely(self, T: FloatArray) -> FloatArray:
        """Return the pose (4, 4) to which the levels lead from ``T``, coarsest first."""
        gate = self.first_gate
        for exponent in range(self.coarsest, self.finest - 1, -1):
            target, source = self.target.level(exponent), self.source.level(exponent)
            last = COARSE_GATE * target.side
            too_coarse = last > COARSEST * gate and exponent > self.finest
            if min(len(target.flat_patches), len(source.flat_patches)) < MIN_PAIRS or too_coarse:
                continue
            gate = max(last, gate)
            for _ in range(COARSE_STEPS):
                step = self._coarse_step(target, source, T, gate)
                if step is None:
                    break
                T = displace(T, step)
                if gate <= last and self._size(step) < COARSE_MOTION * target.side:
                    break
                gate = max(last, GATE_FACTOR * gate)
        return T

    def _coarse_step(
        self, target: Level, source: Level, T: FloatArray, gate: float
    ) -> FloatArray | None:
        """Return a damped step (6,) at ``T`` on one level; None without overlap."""
        pairs, _ = pair_patches(target, source.sample, T, gate)
        if len(pairs) < MIN_PAIRS:
            return None

        # Weigh by the spread of the residuals.
        J, e = pairs[:, JACOBIAN], pairs[:, RESIDUAL]
        scale = max(MIN_SPREAD, robust_spread(e))
        w = weigh(e / scale) / scale**2

        # Solve with the prior, damped.
        H, g = self._reduce(J, w, e)
        prior, pull = self._prior_equations(T)
        unit = self._units()
        scaled = (H + prior) * np.outer(unit, unit)
        damping = max(DAMPING * float(np.trace(scaled)), 1.0) * np.eye(len(unit))
        return self._spread_out(-unit * np.linalg.solve(scaled + damping, unit * (g + pull)))

    # --- the last level ---

    @cached_property
    def shares(self) -> list[_Share]:
        """The source's patches at the levels at which they are flat."""
        return [
            _Share(
                self.target.level(level.exponent),
                np.ascontiguousarray(level.patches[at]),
                fractions,
                level.own_share,
            )
            for level, at, fractions in self.source.choose_cells(self.finest)
            if len(at) and level.exponent <= self.target.coarsest
        ]

    def align_finely(self, T: FloatArray, init: FloatArray) -> tuple[RegistrationResult, float]:
        """Return the result of the steps from ``T`` (4, 4) at the finest level.

        The second value is the share of the source's patches that lie on the target's, 0..1.

        Raises:
            RegistrationError: The clouds do not overlap there.
        """
        # Iterate; once at rest, leave undetermined directions to prior or guess.
        criteria = self.criteria or Criteria()
        iterations, settled, choosy = 0, False, False
        while not settled and iterations < criteria.max_iterations:
            equations = self._pair_finely(T)
            step, dropped = self._fine_step(equations, T, init, choosy)
            T, iterations = displace(T, step), iterations + 1
            small = (
                float(np.linalg.norm(step[:3])) < criteria.translation_epsilon
                and float(np.linalg.norm(step[3:])) < criteria.rotation_epsilon
            )
            settled = small and (choosy or dropped == 0)
            choosy = choosy or small or iterations >= criteria.max_iterations // 2

        # Judge what fits.
        z = standardise(equations.pairs) / equations.spread
        inliers = np.count_nonzero(np.abs(z) < INLIER) / sum(len(s.patches) for s in self.shares)
        return self._result(T, equations, iterations, settled), inliers

    def _pair_finely(self, T: FloatArray) -> _Equations:
        """Return the weighted pairs at ``T``.

        Raises:
            RegistrationError: There are too few.
        """
        # Pair level by level.
        parts, weights = [], []
        for share in self.shares:
            gate = LAST_GATE * share.level.side
            pairs, indices = pair_patches(share.level, share.patches, T, gate)
            variance = pairs[:, SOURCE_VARIANCE] / share.own_share
            variance += pairs[:, TARGET_VARIANCE] / share.level.own_share
            parts.append(pairs)
            weights.append(share.fractions[indices[:, 0]] / np.maximum(variance, MIN_SPREAD**2))
        pairs = np.concatenate(parts) if parts else np.empty((0, PAIR))
        if len(pairs) < MIN_PAIRS:
            raise RegistrationError(
                f"no overlap: only {len(pairs)} pairs of patches, {MIN_PAIRS} are needed; "
                "give a better init_T_target_source"
            )

        # Weigh by the standardised residuals.
        z = standardise(pairs)
        spread = max(1.0, robust_spread(z))
        return _Equations(pairs, np.concatenate(weights) * weigh(z / spread), spread)

    def _fine_step(
        self, equations: _Equations, T: FloatArray, init: FloatArray, choosy: bool
    ) -> tuple[FloatArray, int]:
        """Return the Gauss-Newton step (6,) at ``T`` and the number of undetermined directions.

        A choosy step leaves these to the prior, or to ``init`` where there is none.
        """
        H, g = self._reduce(equations.pairs[:, JACOBIAN], equations.weights, equations.residuals)
        prior, pull = self._prior_equations(T)
        kept, _, dropped = find_determined(H, self._spurious(equations), self.reach)
        if not choosy or len(dropped) == 0:
            kept = np.eye(len(g))
        elif self.prior is None:
            prior = np.diag(self._units() ** -2)
            pull = prior @ deviation(T, init)[list(self.dims)]
        information = kept @ H @ kept.T + prior
        step = -invert_information(information) @ (kept @ g + pull)
        return self._spread_out(step), len(dropped)

    def _spurious(self, equations: _Equations) -> FloatArray:
        """Return the information (k, k) that the difference of the normals fakes."""
        D = equations.pairs[:, DIFFERENCE]
        return self._reduce(D, equations.weights, equations.residuals)[0]

    def _result(
        self, T: FloatArray, equations: _Equations, iterations: int, settled: bool
    ) -> RegistrationResult:
        """Return the result at ``T``, with covariances about the target's origin."""
        # Information on the estimated entries.
        e = equations.residuals
        H, _ = self._reduce(equations.pairs[:, JACOBIAN], equations.weights, e)
        prior, _ = self._prior_equations(T)
        _, honest, dropped = find_determined(H, self._spurious(equations), self.reach)
        rows = list(self.dims)
        information, degenerate = np.zeros((6, 6)), np.zeros((len(dropped), 6))
        information[np.ix_(rows, rows)] = honest @ H @ honest.T + prior
        degenerate[:, rows] = dropped

        # About the target's origin.
        shift = shift_to_target(T)
        back = np.linalg.inv(shift)
        covariance = invert_information(information)
        undetermined = degenerate if self.prior is None else degenerate[:0]
        predicted = predict_rmse_of_moments(self.source.moments.rotated(T[:3, :3]), covariance)
        return RegistrationResult(
            T_target_source=read_only(T),
            covariance=read_only(
                with_infinite_variance(
                    shift @ covariance @ shift.T, undetermined @ shift.T, self.reach
                )
            ),
            information=read_only(back.T @ information @ back),
            fitness=len(equations.pairs) / sum(len(share.patches) for share in self.shares),
            inlier_rmse=math.sqrt(float(np.mean(e * e))),
            predicted_rmse=math.inf if len(undetermined) else predicted,
            num_inliers=len(equations.pairs),
            iterations=iterations,
            converged=settled and len(undetermined) < len(rows),
            degenerate_directions=read_only(degenerate @ shift.T),
            ambiguity_gap=math.nan,
        )

    # --- equations ---

    def _reduce(self, J: FloatArray, w: FloatArray, e: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J^T W J (k, k) and J^T W e (k,) of the estimated entries."""
        weighted = J * w[:, None]
        rows = list(self.dims)
        return (weighted.T @ J)[np.ix_(rows, rows)], (weighted.T @ e)[rows]

    def _prior_equations(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the prior's information (k, k) and gradient at ``T`` (k,); 0 without one."""
        k = len(self.dims)
        if self.prior is None:
            return np.zeros((k, k)), np.zeros(k)
        information = self.prior.information(self.dims)
        return information, information @ self.prior.deviation(T)[list(self.dims)]

    def _units(self) -> FloatArray:
        """Return the factors (k,) that make rotations comparable with translations."""
        return np.where(np.array(self.dims) < 3, 1.0, 1.0 / self.reach)

    def _spread_out(self, step: FloatArray) -> FloatArray:
        """Return a step of the estimated entries (k,) as x y z rx ry rz (6,)."""
        motion = np.zeros(6)
        motion[list(self.dims)] = step
        return motion

    def _size(self, step: FloatArray) -> float:
        """Return the largest motion [m] of points at the distance ``reach`` by a step (6,)."""
        return float(np.linalg.norm(step[:3]) + self.reach * np.linalg.norm(step[3:]))
