"""Roberts' planner: the fewest views that see everything nearly frontally.

D. R. Roberts and A. D. Marshall, Viewpoint selection for complete surface coverage of three
dimensional objects, BMVC 1998: given a model of the object, the smallest set of views is chosen in
which every face is seen from near its best direction, the frontal one. Here the model is what is
already known: the surface that was seen too flat, and the unknown at its border. The set is chosen
anew after every view, and the robot goes to its nearest member; registration plays no part.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import stop_plan
from scan3d_twin.core.planning.surface.set_cover import Cover, solve_set_cover
from scan3d_twin.core.planning.surface.surface_patches import PATCH_SIZE
from scan3d_twin.core.planning.surface.voxels import VOXEL_SIZE
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, Plan

GOOD_COSINE = math.cos(math.radians(45.0))
"""Cosine of the incidence from which on a patch is seen well."""
POOR_COSINE = math.cos(math.radians(60.0))
"""Best cosine of the incidence in all views below which a patch must be seen again."""
COVERED_SHARE = 0.8
"""Share of what the candidates can see that the set must see, so that no view is planned for a few
voxels that another view may show, too; an assumption."""
MAX_TRAVEL_COST = 0.1
"""Largest addition by the travel to a view's cost of 1: among equal sets the nearer one wins."""
COVER_GAP = 0.25
"""Relative gap of the set cover: five views instead of four are accepted, as the robot goes only to
the first before the next set is chosen."""


class RobertsPlanner:
    """The fewest views that see all of what is left, nearly frontally (Roberts, Marshall)."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the nearest view of a smallest set."""
        candidates = PoseCandidates.of(session)
        if reason := candidates.termination_reason():
            return stop_plan(reason)
        if not candidates.worthwhile:
            return candidates.nothing_new()

        # Choose the smallest set
        new, poor = _sees_unknown(candidates), _sees_poor(candidates)
        sees = np.concatenate([new, poor], axis=1)
        areas = np.repeat([VOXEL_SIZE**2, PATCH_SIZE**2], [new.shape[1], poor.shape[1]])
        reachable = float(areas[sees.any(axis=0)].sum())
        cost = MAX_TRAVEL_COST * candidates.travel / max(float(candidates.travel.max()), 1e-9)
        chosen = solve_set_cover(
            Cover(sees, areas, COVERED_SHARE * reachable, cost / len(cost), COVER_GAP)
        )
        assert chosen is not None  # all candidates together see all that is reachable

        # Go to its nearest member
        useful = np.intersect1d(chosen, candidates.worthwhile)
        members = useful if len(useful) else np.array(candidates.worthwhile)
        order = members[np.argsort(candidates.travel[members], kind="stable")]
        poses = tuple(candidates.poses[i] for i in order)
        return candidates.go(poses[0], f"the nearest of {len(chosen)} views that do", poses[1:])


def _sees_unknown(candidates: PoseCandidates) -> BoolArray:
    """Return which candidate sees which unknown voxel at the target's border (m, k)."""
    more = candidates.space.may_hold_more.ravel()
    sees = np.zeros((len(candidates.poses), len(more)), dtype=bool)
    for row, rays in zip(sees, candidates.rays, strict=True):
        row[rays.first[rays.first >= 0]] = True
    sees &= more
    return np.asarray(sees[:, sees.any(axis=0)])


def _sees_poor(candidates: PoseCandidates) -> BoolArray:
    """Return which candidate sees which patch well that no view has seen well yet (m, k)."""
    # Find patches never seen well
    eye, patches = candidates.eye, candidates.surface
    best = np.zeros(len(patches))
    for view in candidates.session.views:
        cosines = eye.cosines(view.T_world_scan, patches)
        seen = eye.sees(view.T_world_scan, patches)
        best = np.maximum(best, np.where(seen, cosines, 0.0))

    # See them from all candidates
    patches = patches.select(best < POOR_COSINE)
    return np.stack(
        [
            eye.sees(pose, patches, candidates.hiding) & (eye.cosines(pose, patches) >= GOOD_COSINE)
            for pose in candidates.poses
        ]
    )
