"""The fewest views, each near the best one.

D. R. Roberts and A. D. Marshall, Viewpoint selection for complete surface coverage of three
dimensional objects, BMVC 1998: from a model of the object the smallest set of views is chosen in
which every face is seen not far from its best, the frontal, direction. Here the model is what is
known so far: the surface that was seen too flat, and the unknown at its border. The set is chosen
anew after every view, and the robot goes to its nearest member; registration plays no part.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning.context import finish
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.set_cover import Cover, fewest
from scan3d_twin.core.planning.surface_patches import PATCH
from scan3d_twin.core.planning.voxels import VOXEL
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, Plan

GOOD = math.cos(math.radians(45.0))
"""A patch counts as seen well by a view no farther than this from its normal."""
POOR = math.cos(math.radians(60.0))
"""A patch that was never seen better than this is seen again."""
ENOUGH = 0.8
"""Share of what the candidates can see that the set must see, so that no view is planned for a few
voxels that the next view shows on the way; an assumption."""
TRAVEL = 0.1
"""Most that the travel to a view adds to its cost of 1: among equal sets the nearer one wins."""
GAP = 0.25
"""A set of five for one of four will do: only its first view is gone to before the next set."""


class RobertsPlanner:
    """The fewest views that see all of what is left, nearly frontally (Roberts, Marshall)."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the nearest view of a smallest set."""
        candidates = PoseCandidates.of(session)
        if reason := candidates.termination_reason():
            return finish(reason)
        if not candidates.worthwhile:
            return candidates.nothing_new()
        new, poor = _unknown(candidates), _poor(candidates)
        sees = np.concatenate([new, poor], axis=1)
        areas = np.repeat([VOXEL**2, PATCH**2], [new.shape[1], poor.shape[1]])
        reachable = float(areas[sees.any(axis=0)].sum())
        cost = TRAVEL * candidates.travel / max(float(candidates.travel.max()), 1e-9)
        chosen = fewest(Cover(sees, areas, ENOUGH * reachable, cost / len(cost), GAP))
        assert chosen is not None  # all candidates together see all that is reachable
        useful = np.intersect1d(chosen, candidates.worthwhile)
        members = useful if len(useful) else np.array(candidates.worthwhile)
        order = members[np.argsort(candidates.travel[members], kind="stable")]
        poses = tuple(candidates.poses[i] for i in order)
        return candidates.go(poses[0], f"the nearest of {len(chosen)} views that do", poses[1:])


def _unknown(candidates: PoseCandidates) -> BoolArray:
    """Tell which candidate sees which unknown voxel at the target's border (m, k)."""
    more = candidates.space.may_hold_more.ravel()
    sees = np.zeros((len(candidates.poses), len(more)), dtype=bool)
    for row, rays in zip(sees, candidates.rays, strict=True):
        row[rays.first[rays.first >= 0]] = True
    sees &= more
    return np.asarray(sees[:, sees.any(axis=0)])


def _poor(candidates: PoseCandidates) -> BoolArray:
    """Tell which candidate sees which patch well that no view has seen well yet (m, k)."""
    eye, patches = candidates.eye, candidates.surface
    best = np.zeros(len(patches))
    for view in candidates.session.views:
        cosines = eye.cosines(view.T_world_scan, patches)
        seen = eye.sees(view.T_world_scan, patches)
        best = np.maximum(best, np.where(seen, cosines, 0.0))
    patches = patches.select(best < POOR)
    return np.stack(
        [
            eye.sees(pose, patches, candidates.hiding) & (eye.cosines(pose, patches) >= GOOD)
            for pose in candidates.poses
        ]
    )
