"""Pito's planner: the smallest overlap that samples enough of the surface again.

R. Pito, A solution to the next best view problem for automated surface acquisition, IEEE Trans.
PAMI 21(10), 1999: a view is admitted if the area that it resamples exceeds a threshold, and the
admitted view with the most new area is chosen. Here the area is weighted by the cosine of its
incidence at the next viewpoint, as a measure of quality, and is a share of the area in the current
view; the smallest admitted overlap shows the most new area. The threshold ignores the shape of the
surface, which is the SiICP paper's criticism.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext, to_world
from scan3d_twin.core.planning.overlap_or_default import list_overlaps, plan_with_overlap
from scan3d_twin.core.planning.surface.surface_patches import Eye, Patches, extract_patches
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan, Pose2


class PitoPlanner:
    """The smallest overlap that resamples enough area (Pito 1999)."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap that resamples enough area."""
        context, config = PlanningContext(session), session.config
        if plan := termination_plan(context):
            return plan

        # Try overlaps, smallest first
        eye = Eye.of(context.view, config)
        current = extract_patches(context.P.points, np.array([0.0, 0.0, eye.height]))
        tried: list[Candidate] = []
        for eta in list_overlaps(config.planning):
            placement = context.find_placement(eta)
            if placement.viewpoint is None:
                continue
            area = measure_resampled_area(current, placement.viewpoint, eye)
            if area >= config.baselines.resampled_area:
                return plan_with_overlap(
                    context, eta, f"resamples {area:.0%} of the area at {eta:.0%}", tried
                )
            viewpoint = to_world(context, placement.viewpoint)
            tried.append(Candidate(viewpoint, eta, math.nan, feasible=True))

        # Fall back to the default
        eta = config.planning.default_overlap
        return plan_with_overlap(
            context, eta, f"no overlap resamples enough: default {eta:.0%}", tried
        )


def measure_resampled_area(current: Patches, viewpoint: Pose2, eye: Eye) -> float:
    """Return the share of the current area that ``viewpoint`` resamples, weighted by the cosine.

    Patches are equally large, so that their number represents the area.
    """
    if len(current) == 0:
        return 0.0
    seen = eye.sees(viewpoint, current)
    return float(np.sum(eye.cosines(viewpoint, current)[seen]) / len(current))
