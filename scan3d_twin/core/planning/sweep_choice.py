"""The sector of the next sweep: as narrow as the target and the registration allow.

A sweep turns at 5 deg/s, so that its angle is most of the time that a view takes. What shows the
target is often a small part of it; the rest shows the surroundings, by which the view is
registered, too. Sectors of growing angle are candidates, and the first one whose predicted error
meets epsilon is taken: where the surroundings are needed, the sweep stays wide. So it does where
the floor is not known yet on which the next move would end, if it is like this one: a panorama to
look for it takes longer than what a narrow sweep saves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.types import Plan, Pose2

FREE_ANGLE = math.radians(5.0)
"""Angle seen beyond the gap that ends a target [rad]: ten lines."""
NEXT_STEPS = (1.0, 1.3)
"""Lengths of the next move, in those of this one, for which the floor must be known: steps differ
by the share of the surface that the target's next side has more."""
TARGET_STRIDE = 13
"""Stride of the target's points whose bearings are compared; a prime, so that all beams count."""

SectorError = Callable[[Pose2, float], float]
"""Returns the error [m] of a viewpoint in frame ``scan`` with half the angle of its sweep [rad]."""


def narrow_sweep(context: PlanningContext, plan: Plan, error: SectorError) -> Plan:
    """Return ``plan`` with the smallest sector whose error meets epsilon; else as it is.

    Args:
        context: After the latest view.
        plan: Where to go; ``planning.sector`` must be ``target`` for a narrower sweep there.
        error: The predicted error.
    """
    config = context.session.config
    if plan.viewpoint is None or plan.fell_back or config.planning.sector == "whole":
        return plan

    # Look at the floor ahead where it is not known
    viewpoint = context.view.T_world_scan.inverse() @ plan.viewpoint
    if not (context.is_contour_done or _is_floor_known_ahead(context, viewpoint)):
        return plan

    # Try the target's own sector and one between it and the whole
    whole, least = config.sweep.width / 2 + config.sweep.margin, measure_sector(context, viewpoint)
    for half in (least, (least + whole) / 2):
        if half >= whole:
            break
        predicted = error(viewpoint, half)
        if predicted <= config.planning.epsilon:
            return replace(plan, half_width=half, predicted_rmse=predicted)
    return plan


def _is_floor_known_ahead(context: PlanningContext, step: Pose2) -> bool:
    """Return whether the next move after this ``step`` can be planned by what is known now."""
    moves = (Pose2(factor * step.x, factor * step.y, step.yaw) for factor in NEXT_STEPS)
    return all(context.is_feasible(step @ move) for move in moves)


def measure_sector(context: PlanningContext, viewpoint: Pose2) -> float:
    """Return half the angle [rad] of a sweep that shows the target and where it ends.

    What counts is at most ``sweep.width``, and all of it where a view is for hidden surface, which
    may be anywhere in it. Along the contour the known part of the target lies on one side of a
    viewpoint that faces the next segment; as much is expected on the other.
    """
    session, config = context.session, context.session.config
    if context.is_contour_done:
        return config.sweep.width / 2

    # Measure the bearings of the known target
    there = context.view.T_world_scan @ viewpoint
    seen = [view.T_world_scan.apply(view.target.points[::TARGET_STRIDE]) for view in session.views]
    points = there.inverse().apply(np.concatenate(seen))
    bearings = np.abs(np.arctan2(points[:, 1], points[:, 0]))

    # Look beyond its end
    beyond = config.target.cluster_gap / config.planning.standoff + FREE_ANGLE
    extent = float(np.max(bearings[bearings <= math.pi / 2], initial=0.0))
    return min(extent, config.sweep.width / 2) + beyond
