"""Feature score of the surface that the next view had to overlap (the claim of Fig. 11)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d_twin.core.planning.context import MIN_LINES, PlanningContext
from scan3d_twin.core.planning.planners.curvature import score_features
from scan3d_twin.core.planning.surface.surface_patches import extract_patches, lidar_height
from scan3d_twin.core.session import Session

SCORED_SHARE = 0.5
"""Share of the latest view, on the travel side, that is scored: half way between the smallest and
the largest overlaps of the paper."""


def feature_score_before(session: Session, k: int) -> float | None:
    """Return the feature score at the planning step after view ``k``; None where there was no step.

    The score is the spread of the normals (curvature.py), whichever planner ran.
    """
    if k + 1 >= len(session.views):
        return None
    context = PlanningContext(replace(session, views=session.views[: k + 1]))
    if context.n_lines < MIN_LINES:
        return None
    eye = np.array([0.0, 0.0, lidar_height(context.view)])
    Q = extract_patches(context.P.last_lines(context.n_Q(SCORED_SHARE)).points, eye)
    return score_features(Q, len(extract_patches(context.P.points, eye)), "normals")
