"""The overlap by a feature score instead of a simulated registration.

Invariant features are how scans were registered before ICP (Besl and Jain, Invariant surface
characteristics for 3D object recognition in range images, CVGIP 33, 1986). The share of the current
surface that holds features, in the part that would be seen again, must reach a threshold.

``normals``: a wall lets a planar registration slide along itself. Of the normals' histogram in
the plane, M = sum of n n^T over the patches of Q, the smaller eigenvalue is the area that holds the
weaker direction. ``variation``: the area whose surface variation l3 / (l1 + l2 + l3) is above that
of a plane with noise (Pauly, Gross and Kobbelt, VIS 2002).
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import Feature
from scan3d_twin.core.planning.context import PlanningContext, in_world
from scan3d_twin.core.planning.hidden_views import termination_plan
from scan3d_twin.core.planning.overlap_search import list_overlaps, plan_with_overlap
from scan3d_twin.core.planning.surface_patches import Patches, eye_height, patches_of
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan

CURVED = 0.03
"""Surface variation above which a patch is a feature: noise of 5 mm on a flat neighbourhood of 0.12
m makes 0.01, a right-angled edge 0.1."""


class CurvaturePlanner:
    """The smallest overlap that holds enough features."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose feature score is high enough."""
        context, config = PlanningContext(session), session.config
        if plan := termination_plan(context):
            return plan
        eye = np.array([0.0, 0.0, eye_height(context.view)])
        whole = patches_of(context.P.points, eye)
        tried: list[Candidate] = []
        for eta in list_overlaps(config.planning):
            placement = context.place(eta)
            if placement.viewpoint is None:
                continue
            Q = patches_of(context.P.last_lines(context.n_Q(eta)).points, eye)
            score = feature_score(Q, len(whole), config.baselines.feature)
            if score >= config.baselines.feature_score:
                return plan_with_overlap(
                    context, eta, f"feature score {score:.3f} at {eta:.0%}", tried
                )
            viewpoint = in_world(context, placement.viewpoint)
            tried.append(Candidate(viewpoint, eta, math.nan, feasible=True))
        eta = config.planning.default_overlap
        return plan_with_overlap(context, eta, f"too few features: default {eta:.0%}", tried)


def feature_score(Q: Patches, whole: int, feature: Feature) -> float:
    """Return the share of the ``whole`` number of patches that are features in Q; grows with Q."""
    if len(Q) == 0 or whole == 0:
        return 0.0
    if feature == "variation":
        return float(np.count_nonzero(Q.variation > CURVED)) / whole
    flat = Q.normals[:, :2]
    return float(np.linalg.eigvalsh(flat.T @ flat)[0]) / whole
