"""Pito's overlap constraint: enough of the surface must be sampled again.

R. Pito, A solution to the next best view problem for automated surface acquisition, IEEE Trans.
PAMI 21(10), 1999: a view is admitted by a threshold on the area it resamples, and of the admitted
ones the one with the most new area is taken. Here the area is weighted by the cosine of its
incidence at the next viewpoint, as the quality of what is sampled there, and stated as the share of
the area in the current view; the most new area is that of the smallest overlap admitted. The
threshold knows nothing of the surface's shape, which is what the SiICP paper holds against it.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning.context import PlanningContext, in_world
from scan3d_twin.core.planning.hidden_views import termination_plan
from scan3d_twin.core.planning.overlap_search import list_overlaps, plan_with_overlap
from scan3d_twin.core.planning.surface_patches import Eye, Patches, patches_of
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan, Pose2


class PitoPlanner:
    """The smallest overlap that resamples enough area (Pito 1999)."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap that is admitted."""
        context, config = PlanningContext(session), session.config
        if plan := termination_plan(context):
            return plan
        eye = Eye.of(context.view, config)
        current = patches_of(context.P.points, np.array([0.0, 0.0, eye.height]))
        tried: list[Candidate] = []
        for eta in list_overlaps(config.planning):
            placement = context.place(eta)
            if placement.viewpoint is None:
                continue
            area = resampled_area(current, placement.viewpoint, eye)
            if area >= config.baselines.resampled_area:
                return plan_with_overlap(
                    context, eta, f"resamples {area:.0%} of the area at {eta:.0%}", tried
                )
            viewpoint = in_world(context, placement.viewpoint)
            tried.append(Candidate(viewpoint, eta, math.nan, feasible=True))
        eta = config.planning.default_overlap
        return plan_with_overlap(
            context, eta, f"no overlap resamples enough: default {eta:.0%}", tried
        )


def resampled_area(current: Patches, viewpoint: Pose2, eye: Eye) -> float:
    """Return the share of the current patches that ``viewpoint`` samples again, times its cosine.

    Patches are equally large, so that their number stands for the area.
    """
    if len(current) == 0:
        return 0.0
    seen = eye.sees(viewpoint, current)
    return float(np.sum(eye.cosines(viewpoint, current)[seen]) / len(current))
