"""Registration of unorganised point clouds, for scans without lines and beams.

Both clouds are reduced to flat patches at several resolutions (``patches``) and aligned from
a guess (``alignment``).

**Doubt.** Where less than ``SURE_INLIERS`` of the source lies on the target, more starts are tried.
Basins are judged by what does not fit and by the free space of either cloud (``panorama``). A
result has converged if the steps are small, something is determined, neither cloud has more than
``MAX_CONTRADICTION`` of its patches in the other's free space, and no other basin is as good.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.clouds.alignment import COARSE_GATE, CloudAlignment
from scan3d_twin.core.registration.clouds.patches import POINT, Cloud, prepare_cloud
from scan3d_twin.core.registration.gauss_newton import (
    MIN_PAIRS,
    SAME_BASIN,
    Criteria,
    Dof,
    distance_between,
)
from scan3d_twin.core.registration.multistart import first_guess, spread_normal
from scan3d_twin.core.registration.pose_prior import PosePrior, displace
from scan3d_twin.core.types import FloatArray, RegistrationResult

EXTRA_STARTS = 8
"""Starts besides the guess, where a single one leaves doubt."""
START_SIGMA, START_TURN = 0.35, math.radians(5.0)
"""Spread of the starts without a prior, in first gates and in rad."""
SURE_INLIERS = 0.85
"""Share of the source on the target above which one start is enough."""
MAX_CONTRADICTION = 0.01
"""Largest contradiction of a right pose: in simulated scenes right ones have up to 0.003, wrong
ones 0.017 to 0.13."""
MIN_INLIERS = 0.3
"""Least share of the source on the target of a right pose."""
MIN_GAP = 0.02
"""Least significant gap in misfit between two basins."""


def register_clouds(
    target: Cloud | FloatArray,
    source: Cloud | FloatArray,
    *,
    init_T_target_source: FloatArray | None = None,
    prior: PosePrior | None = None,
    dof: Dof = "planar",
    criteria: Criteria | None = None,
    starts: int = 1,
) -> RegistrationResult:
    """Register the cloud ``source`` to the cloud ``target``.

    Args:
        target: Points (n, 3) [m] seen from their origin, or the result of ``prepare_cloud``.
        source: Points (m, 3) [m] seen from their origin, or the result of ``prepare_cloud``.
        init_T_target_source: Initial guess (4, 4); by default the prior's mean, else identity.
        prior: Prior distribution of the pose; it decides in directions the clouds leave free.
        dof: ``planar`` estimates x, y and theta, ``se3`` all six.
        criteria: Convergence criteria and the first gate; by default the gate is as wide as the
            prior expects, else half the target's radius, at most 2 m.
        starts: Number of starts, spread over the prior, or without one about the guess. A single
            one is followed by others where its result leaves doubt.

    Raises:
        ConfigError: A pose or a shape is wrong.
        RegistrationError: A cloud is too small, or the two do not overlap.
    """
    if dof not in ("planar", "se3"):
        raise ConfigError(f"dof must be planar or se3, got {dof!r}")
    if starts < 1:
        raise ConfigError(f"starts must be >= 1, got {starts}")
    init = first_guess(init_T_target_source, prior)
    alignment = CloudAlignment(_as_cloud(target), _as_cloud(source), prior, dof, criteria)
    if alignment.finest > alignment.coarsest:
        raise RegistrationError(
            "the clouds are too unlike in size and density: they have no resolution in common"
        )

    # One start, if nearly all patches fit.
    basins = _refine(alignment, alignment.align_coarsely(init), init)
    if starts == 1 and basins and basins[0].plausible and basins[0].inliers >= SURE_INLIERS:
        return basins[0].result

    # Others, aligned finely where they lead elsewhere.
    count = max(starts, EXTRA_STARTS)
    for start in _spread_starts(alignment, init, count):
        T = alignment.align_coarsely(start)
        if all(_is_apart(alignment, T, basin.result.T_target_source) for basin in basins):
            basins += _refine(alignment, T, init)
    if not basins:
        raise RegistrationError(
            f"no overlap: none of {count + 1} starts found {MIN_PAIRS} pairs of patches; "
            "give a better init_T_target_source"
        )
    return _choose(alignment, basins, init)


def _as_cloud(cloud: Cloud | FloatArray) -> Cloud:
    return cloud if isinstance(cloud, Cloud) else prepare_cloud(cloud)


@dataclass(frozen=True)
class _Basin:
    """Where the steps from a start ended.

    Attributes:
        result: The result there.
        inliers: Share of the source's patches that lie on the target's, 0..1.
        contradiction: Share of the patches of either cloud in the other's free space, 0..1.
    """

    result: RegistrationResult
    inliers: float
    contradiction: float

    @property
    def plausible(self) -> bool:
        """Whether the clouds may lie like this."""
        free = self.contradiction <= MAX_CONTRADICTION and self.inliers >= MIN_INLIERS
        return free and self.result.converged

    @property
    def misfit(self) -> float:
        """Score to choose by: what does not fit, and what cannot be."""
        return 1.0 - self.inliers + min(1.0, self.contradiction / MAX_CONTRADICTION)


def _spread_starts(alignment: CloudAlignment, init: FloatArray, n: int) -> FloatArray:
    """Return n poses (n, 4, 4) spread over the prior, or without one about ``init``."""
    dims = list(alignment.dims)
    offsets = np.zeros((n, 6))
    if alignment.prior is None:
        sigmas = np.where(np.array(dims) < 3, START_SIGMA * alignment.first_gate, START_TURN)
        offsets[:, dims] = spread_normal(n, len(dims)) * sigmas
        return displace(init, offsets)
    half = np.linalg.cholesky(alignment.prior.covariance[np.ix_(dims, dims)])
    offsets[:, dims] = spread_normal(n, len(dims)) @ half.T
    return displace(alignment.prior.T, offsets)


def _refine(alignment: CloudAlignment, T: FloatArray, init: FloatArray) -> list[_Basin]:
    """Return the basin about ``T`` (4, 4); none without overlap."""
    with suppress(RegistrationError):
        result, inliers = alignment.align_finely(T, init)
        contradiction = _measure_contradiction(alignment, result.T_target_source)
        return [_Basin(result, inliers, contradiction)]
    return []


def _is_apart(alignment: CloudAlignment, T: FloatArray, other: FloatArray) -> bool:
    """Return whether two poses (4, 4) belong to different basins."""
    least = max(SAME_BASIN, COARSE_GATE * alignment.target.level(alignment.finest).side)
    return distance_between(T, other, alignment.reach) > least


def _choose(
    alignment: CloudAlignment, basins: list[_Basin], init: FloatArray
) -> RegistrationResult:
    """Return the result of the best basin, among equals the nearest to ``init`` (4, 4)."""
    basins = sorted(basins, key=lambda basin: basin.misfit)
    equal = [b for b in basins if b.misfit - basins[0].misfit < MIN_GAP]
    best = min(
        equal, key=lambda b: distance_between(b.result.T_target_source, init, alignment.reach)
    )
    gaps = [
        basin.misfit - best.misfit
        for basin in basins
        if _is_apart(alignment, basin.result.T_target_source, best.result.T_target_source)
    ]
    gap = max(0.0, min([1.0, *gaps]))
    return replace(best.result, converged=best.plausible and gap >= MIN_GAP, ambiguity_gap=gap)


def _measure_contradiction(alignment: CloudAlignment, T: FloatArray) -> float:
    """Return the share of either cloud's patches in the other's free space, 0..1."""
    margin = COARSE_GATE * alignment.target.level(alignment.finest).side
    clouds, poses = (alignment.target, alignment.source), (T, np.linalg.inv(T))
    patches = [cloud.level(alignment.finest).flat_patches[:, POINT] for cloud in clouds]
    shares = [0.0]
    for cloud, own, other, pose in zip(clouds, patches, patches[::-1], poses, strict=True):
        moved = other @ pose[:3, :3].T + pose[:3, 3]
        usual = cloud.panorama.contradiction(own, margin)
        shares.append(cloud.panorama.contradiction(moved, margin) - usual)
    return max(shares)
