"""Curvature planner: the overlap by a feature score instead of a simulated registration.

Before ICP, scans were registered by invariant features (Besl and Jain, Invariant surface
characteristics for 3D object recognition in range images, CVGIP 33, 1986). The features in the
overlap, as a share of the current surface, must reach a threshold.

``normals``: a wall lets a planar registration slide along itself. The smaller eigenvalue of
M = sum of n n^T over the patches of Q is the area that constrains the weaker direction.
``variation``: the area whose surface variation l3 / (l1 + l2 + l3) is above that of a noisy plane
(Pauly, Gross and Kobbelt, VIS 2002).
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext, to_world
from scan3d_twin.core.planning.overlap_or_default import list_overlaps, plan_with_overlap
from scan3d_twin.core.planning.surface.surface_patches import Patches, extract_patches, lidar_height
from scan3d_twin.core.planning_config import Feature
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan

MIN_VARIATION = 0.03
"""Surface variation above which a patch is a feature: that of a flat neighbourhood of 0.12 m with
5 mm of noise is 0.01, that of a right-angled edge 0.1."""


class CurvaturePlanner:
    """The smallest overlap that holds enough features."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose feature score is high enough."""
        context, config = PlanningContext(session), session.config
        if plan := termination_plan(context):
            return plan

        # Try overlaps, smallest first
        eye = np.array([0.0, 0.0, lidar_height(context.view)])
        whole = extract_patches(context.P.points, eye)
        tried: list[Candidate] = []
        for eta in list_overlaps(config.planning):
            placement = context.find_placement(eta)
            if placement.viewpoint is None:
                continue
            Q = extract_patches(context.P.last_lines(context.n_Q(eta)).points, eye)
            score = score_features(Q, len(whole), config.baselines.feature)
            if score >= config.baselines.feature_score:
                return plan_with_overlap(
                    context, eta, f"feature score {score:.3f} at {eta:.0%}", tried
                )
            viewpoint = to_world(context, placement.viewpoint)
            tried.append(Candidate(viewpoint, eta, math.nan, feasible=True))

        # Fall back to the default
        eta = config.planning.default_overlap
        return plan_with_overlap(context, eta, f"too few features: default {eta:.0%}", tried)


def score_features(Q: Patches, whole: int, feature: Feature) -> float:
    """Return the number of features in Q as a share of all ``whole`` patches; it grows with Q."""
    if len(Q) == 0 or whole == 0:
        return 0.0
    if feature == "variation":
        return float(np.count_nonzero(Q.variation > MIN_VARIATION)) / whole
    flat = Q.normals[:, :2]
    return float(np.linalg.eigvalsh(flat.T @ flat)[0]) / whole
