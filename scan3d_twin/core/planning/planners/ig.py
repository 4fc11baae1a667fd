"""Information-gain planner: the most volumetric information gain for the travel.

S. Isler et al., An information gain formulation for active volumetric 3D reconstruction, ICRA 2016,
and J. Delmerico et al., A comparison of volumetric information gain metrics for active 3D object
reconstruction, Autonomous Robots 42, 2018. With p the occupancy of a voxel, H its entropy and Pv
the probability that a ray gets there, the gain of a ray is

* ``oa`` (occlusion aware): sum of Pv H(p) over all its voxels;
* ``rse`` (rear side entropy): the same over the unknown voxels directly behind which a surface was
  seen from its other side, that is over the unknown run that ends in an occupied voxel;
* ``af`` (area factor; Vasquez-Gomez, Lopez-Damian and Sucar, IROS 2009): no sum over rays, but
  f(share that meets known surface) + f(share that meets the unknown beside it), with desired
  shares of one and four fifths: the only one that asks for an overlap.

Utility: the share of all candidates' gain, less the weighted share of all their travel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import stop_plan
from scan3d_twin.core.planning.surface.voxels import OCCUPIED, UNKNOWN, Rays, VoxelMap
from scan3d_twin.core.planning_config import Gain
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan

OCCUPANCY = np.array([0.5, 0.1192, 0.971])
"""Occupancy p of unknown, free and occupied voxels; the latter two are the clamping thresholds of
OctoMap (Hornung et al. 2013)."""
ENTROPY = -OCCUPANCY * np.log(OCCUPANCY) - (1 - OCCUPANCY) * np.log(1 - OCCUPANCY)
"""Entropy H(p) of unknown, free and occupied voxels [nat]."""
KNOWN_SHARE, NEW_SHARE = 0.2, 0.8
"""Desired shares of the area factor; the overlap of 20 % is that of Vasquez-Gomez et al."""


class IgPlanner:
    """The most volumetric information gain (oa, rse or af) for the travel."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the candidate of the largest utility."""
        candidates, config = PoseCandidates.of(session), session.config.baselines
        if reason := candidates.termination_reason():
            return stop_plan(reason)
        if not candidates.worthwhile:
            return candidates.nothing_new()
        gains = np.array(
            [compute_gain(rays, candidates.space, config.gain) for rays in candidates.rays]
        )
        values = compute_utility(gains, candidates.travel, config.travel_weight)
        few = np.setdiff1d(np.arange(len(values)), candidates.worthwhile)
        values[few] = -np.inf
        return candidates.best(values, f"most information gain ({config.gain}) for the travel")


def compute_utility(gains: FloatArray, travel: FloatArray, weight: float) -> FloatArray:
    """Return each candidate's share of all gain less ``weight`` times its share of all travel."""
    return np.asarray(
        gains / max(float(gains.sum()), 1e-12) - weight * travel / max(float(travel.sum()), 1e-12)
    )


def compute_gain(rays: Rays, space: VoxelMap, which: Gain) -> float:
    """Return the information gain of one candidate's rays."""
    return _GAINS[which](rays, space)


def _occlusion_aware(rays: Rays, space: VoxelMap) -> float:
    """Return the sum over all voxels of all rays."""
    return float(np.sum(_weighted_entropy(rays)))


def _rear_side_entropy(rays: Rays, space: VoxelMap) -> float:
    """Return the sum over the unknown voxels of each ray in the run that ends in a surface."""
    # Run backwards along the rays
    H, unknown, occupied = _weighted_entropy(rays), *_unknown_and_occupied(rays)
    behind = np.zeros(len(H), dtype=bool)
    total = 0.0
    for k in range(H.shape[1] - 1, -1, -1):
        behind = occupied[:, k] | (behind & unknown[:, k])
        total += float(np.sum(H[behind & unknown[:, k], k]))
    return total


def _area_factor(rays: Rays, space: VoxelMap) -> float:
    """Return the desirability of the shares of known surface and of the unknown beside it."""
    first = rays.first
    hit = first[first >= 0]
    if len(hit) == 0:
        return 0.0
    known = int(np.count_nonzero(space.target.ravel()[hit]))
    new = int(np.count_nonzero(space.may_hold_more.ravel()[hit]))
    both = max(1, known + new)
    return rate_share(known / both, KNOWN_SHARE) + rate_share(new / both, NEW_SHARE)


_GAINS: dict[Gain, Callable[[Rays, VoxelMap], float]] = {
    "oa": _occlusion_aware,
    "rse": _rear_side_entropy,
    "af": _area_factor,
}


def rate_share(share: float, desired: float) -> float:
    """Return f(share) of the area factor: two cubics from 0 at both ends to 1 at ``desired``."""
    x, a = share, desired
    if x <= a:
        return -2 * x**3 / a**3 + 3 * x**2 / a**2
    b = (a - 1) ** 3
    return (-2 * x**3 + 3 * (a + 1) * x**2 - 6 * a * x + 3 * a - 1) / b


def _weighted_entropy(rays: Rays) -> FloatArray:
    """Return Pv H(p) of each voxel on each ray (n_rays, n_steps); none outside of the map."""
    p = np.where(rays.index >= 0, OCCUPANCY[rays.labels], 0.0)
    H = np.where(rays.index >= 0, ENTROPY[rays.labels], 0.0)
    reached = np.cumprod(1.0 - p, axis=1)
    return np.asarray(np.concatenate([np.ones((len(p), 1)), reached[:, :-1]], axis=1) * H)


def _unknown_and_occupied(rays: Rays) -> tuple[FloatArray, FloatArray]:
    inside = rays.index >= 0
    return inside & (rays.labels == UNKNOWN), inside & (rays.labels == OCCUPIED)
