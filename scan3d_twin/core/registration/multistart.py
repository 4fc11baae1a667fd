"""Multistart registration: starts spread over the prior, their basins judged by free space.

A periodic surface fits equally well one period off. The contradiction of each basin with free space
separates them. If it does not, a small ambiguity gap says so, and the basin nearest to the prior is
taken. A pose that free space contradicts, whichever start led there, has not converged.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from statistics import NormalDist

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.gauss_newton import (
    SAME_BASIN,
    Criteria,
    Dof,
    Problem,
    RunResult,
    align,
    distance_between,
    follow_starts,
    make_result,
)
from scan3d_twin.core.registration.pose_prior import PosePrior, displace
from scan3d_twin.core.registration.surfels.free_space import (
    MAX_CONTRADICTION,
    find_contradicted_share,
    measure_contradiction,
)
from scan3d_twin.core.registration.surfels.grid import SurfelGrid
from scan3d_twin.core.types import FloatArray, RegistrationResult, read_only

ROUGH_ITERATIONS = (2, 3)
"""Steps of each start in two rounds; after each, starts that met in one basin are merged."""
ROUGH_THINNING = 2
"""Factor on the stride in these steps."""
NO_OVERLAP = "no overlap: none of {} starts found pairs of surfels; is the prior right?"
MAX_BASINS = 6
"""Basins that are aligned to convergence, least contradictory first."""
MIN_CONTRADICTION_GAP = 0.01
"""Least significant gap in contradiction: twice what noise alone gives two scans."""


@dataclass(frozen=True)
class Basin:
    """A pose at which the iteration converged, and its contradiction with free space, 0..1."""

    outcome: RunResult
    contradiction: float

    @property
    def T(self) -> FloatArray:
        """The pose ``T_target_source`` (4, 4)."""
        return self.outcome.T


def register_grids(
    target: SurfelGrid,
    source: SurfelGrid,
    *,
    init_T_target_source: FloatArray | None = None,
    prior: PosePrior | None = None,
    dof: Dof = "planar",
    criteria: Criteria | None = None,
    starts: int = 1,
) -> RegistrationResult:
    """Register the sweep ``source`` to the sweep ``target``.

    Args:
        target: From ``extract_surfels``.
        source: From ``extract_surfels``.
        init_T_target_source: Initial guess (4, 4); by default the prior's mean, else identity.
        prior: Prior distribution of the pose; it decides in directions the scans leave free.
        dof: ``planar`` estimates x, y and theta, ``se3`` all six.
        criteria: Convergence criteria.
        starts: Number of starts, spread over the prior, to find the best of several basins.

    Raises:
        ConfigError: A pose is not finite, or an option is wrong.
        RegistrationError: The scans do not overlap.
    """
    problem = Problem(target, source, prior, dof, criteria or Criteria())
    init = first_guess(init_T_target_source, prior)

    # Use all surfels where a sample has too few in common
    try:
        outcome, gap = search_basins(problem, init, starts)
    except RegistrationError:
        problem = replace(problem, whole=True)
        outcome, gap = search_basins(problem, init, starts)
    result = make_result(problem, outcome, gap)

    # Distrust a match with another surface
    share = find_contradicted_share(target, source, outcome.T, problem.stride)
    return replace(result, converged=False) if share > MAX_CONTRADICTION else result


def first_guess(init: FloatArray | None, prior: PosePrior | None) -> FloatArray:
    """Return where a registration begins: at ``init`` (4, 4), else at the prior's mean.

    Raises:
        ConfigError: It is no finite transform.
    """
    if init is None:
        return np.eye(4) if prior is None else prior.T
    if init.shape != (4, 4) or not np.isfinite(init).all():
        raise ConfigError("init_T_target_source must be a finite (4, 4) transform")
    return init


def search_basins(problem: Problem, init: FloatArray, starts: int) -> tuple[RunResult, float]:
    """Return the result in the best basin and the gap in contradiction to the next, 0..1.

    The gap is 1 if all starts ended in one basin, and NaN for a single start, which knows no other.
    Where the overlap is too narrow for the thinned surfels of the rough steps, ``init`` is the only
    start.

    Raises:
        ConfigError: Several starts are wanted, but there is no prior to spread them over.
        RegistrationError: The scans do not overlap.
    """
    if starts < 1:
        raise ConfigError(f"starts must be >= 1, got {starts}")
    if starts == 1:
        return align(problem, init), math.nan

    # Iterate roughly, merging basins.
    poses, source = spread_starts(problem, init, starts), problem.make_source(ROUGH_THINNING)
    for iterations in ROUGH_ITERATIONS:
        criteria = problem.criteria._replace(max_iterations=iterations)
        poses = follow_starts(problem, source, criteria, poses)[0]
        if len(poses) == 0:
            return align(problem, init), math.nan

    # Align the least contradictory.
    ranked = [*poses]
    if len(ranked) > 1:
        ranked.sort(key=lambda pose: _measure_contradiction(problem, pose))
    outcomes = []
    for pose in ranked[:MAX_BASINS]:
        with suppress(RegistrationError):
            outcomes.append(align(problem, pose))
    if not outcomes:
        raise RegistrationError(NO_OVERLAP.format(starts))
    return _choose(problem, outcomes)


def spread_starts(problem: Problem, init: FloatArray, starts: int) -> FloatArray:
    """Return ``init`` and poses spread over the prior (starts, 4, 4).

    Raises:
        ConfigError: There is no prior.
    """
    if problem.prior is None:
        raise ConfigError("several starts need a prior to spread them over")
    dims = list(problem.dims)
    half = np.linalg.cholesky(problem.prior.covariance[np.ix_(dims, dims)])
    offsets = np.zeros((starts - 1, 6))
    offsets[:, dims] = spread_normal(starts - 1, len(dims)) @ half.T
    return np.concatenate([init[None], displace(problem.prior.T, offsets)])


@cache
def spread_normal(n: int, k: int) -> FloatArray:
    """Return n points (n, k) spread over the standard normal distribution of k dimensions.

    The additive sequence of the generalised golden ratio g, g^(k+1) = g + 1, fills the cube evenly
    for any number of points; quantiles of the normal distribution make it one.
    """
    g = 1.5
    for _ in range(60):
        g = (1.0 + g) ** (1.0 / (k + 1))
    steps = g ** -np.arange(1.0, k + 1)
    cube = (0.5 + np.arange(1, n + 1)[:, None] * steps) % 1.0
    quantile = NormalDist().inv_cdf
    return read_only(np.array([[quantile(share) for share in row] for row in cube.tolist()]))


def _measure_contradiction(problem: Problem, pose: FloatArray) -> float:
    return measure_contradiction(problem.target, problem.source, pose, 2 * problem.stride)


def _choose(problem: Problem, outcomes: list[RunResult]) -> tuple[RunResult, float]:
    """Return the least contradictory result and its gap; among equals the nearest to the prior."""
    if len(outcomes) == 1:
        return outcomes[0], 1.0
    basins = [Basin(each, _measure_contradiction(problem, each.T)) for each in outcomes]
    distinct: list[Basin] = []
    for basin in sorted(basins, key=lambda basin: basin.contradiction):
        if all(distance_between(basin.T, b.T, problem.reach) > SAME_BASIN for b in distinct):
            distinct.append(basin)
    if len(distinct) == 1:
        return distinct[0].outcome, 1.0
    gap = distinct[1].contradiction - distinct[0].contradiction
    equal = [
        b for b in distinct if b.contradiction - distinct[0].contradiction < MIN_CONTRADICTION_GAP
    ]
    return min(equal, key=lambda basin: _prior_distance(problem, basin.T)).outcome, gap


def _prior_distance(problem: Problem, pose: FloatArray) -> float:
    """Return the squared Mahalanobis distance of a pose from the prior's mean; 0 without one."""
    if problem.prior is None:
        return 0.0
    off = problem.prior.deviation(pose)[list(problem.dims)]
    return float(off @ problem.prior.information(problem.dims) @ off)
