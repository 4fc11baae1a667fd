"""The sector of the next sweep: as narrow as the target and the registration allow.

A sweep turns at 5 deg/s, so that its angle is most of the time that a view takes. What shows the
target is often a small part of it; the rest shows the surroundings, by which the view is
registered, too. Sectors of growing angle are candidates, and the first one whose predicted error
meets epsilon is taken: where the surroundings are needed, the sweep stays wide. Where nothing meets
it, the first one is taken that is not worse than the whole, unless the target reaches beyond it:
the next view is registered on what this one shows. To one side the sweep goes on as far as shows
the floor on which the next move would end, if it is like this one and that floor is not known yet:
a panorama to look for it takes longer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan, Pose2

FREE_ANGLE = math.radians(5.0)
"""Angle seen beyond the gap that ends a target [rad]: ten lines."""
NEXT_STEPS = (1.0, 1.3)
"""Lengths of the next move, in those of this one, for which the floor must be known: steps differ
by the share of the surface that the target's next side has more."""
AS_GOOD = 1.02
"""Error of a narrow sector, in those of the whole one, up to which it is not worse."""
TARGET_STRIDE = 13
"""Stride of the target's points whose bearings are compared; a prime, so that all beams count."""

SectorError = Callable[[Pose2, float], float]
"""Returns the error [m] of a viewpoint in frame ``scan`` with half the angle of its sweep [rad]."""


def narrow_sweep(context: PlanningContext, plan: Plan, error: SectorError) -> Plan:
    """Return ``plan`` with the smallest sector that will do; else as it is.

    Its error meets epsilon or, where the plan's does not, is no larger than that.

    Args:
        context: After the latest view.
        plan: Where to go; ``planning.sector`` must be ``target`` for a narrower sweep there.
        error: The predicted error.
    """
    config = context.session.config
    if plan.viewpoint is None or config.planning.sector == "whole":
        return plan
    viewpoint = context.view.T_world_scan.inverse() @ plan.viewpoint
    least, is_shown = measure_sector(context, viewpoint)
    largest = config.planning.epsilon
    if plan.fell_back and is_shown:
        largest = max(largest, AS_GOOD * plan.predicted_rmse)

    # Try the target's own sector and one between it and the whole
    whole = config.sweep.width / 2 + config.sweep.margin
    for half in (least, (least + whole) / 2):
        if half >= whole:
            break
        predicted = error(viewpoint, half)
        if predicted <= largest:
            beyond = _look_ahead(context, viewpoint, half, whole)
            return replace(plan, half_width=half, beyond=beyond, predicted_rmse=predicted)
    return plan


def _look_ahead(context: PlanningContext, step: Pose2, half: float, whole: float) -> float:
    """Return the angle beyond ``half`` [rad] that shows the floor of the next move, if not known.

    It is positive to the left; a sweep ends ``whole`` [rad] from its middle at the latest. Where
    the contour is complete the next move is not like this ``step``.
    """
    moves = (Pose2(factor * step.x, factor * step.y, step.yaw) for factor in NEXT_STEPS)
    if context.is_contour_done or all(context.is_feasible(step @ move) for move in moves):
        return 0.0
    motion = context.session.config.motion
    body, length = motion.robot_radius + motion.clearance, math.hypot(step.x, step.y)
    bearing = math.atan2(step.y, step.x)
    end = abs(bearing) + math.asin(min(1.0, body / max(length, body))) + FREE_ANGLE
    return math.copysign(max(0.0, min(end, whole) - half), bearing)


def measure_sector(context: PlanningContext, viewpoint: Pose2) -> tuple[float, bool]:
    """Return half the angle [rad] of a sweep that shows the target, and whether it shows all of it.

    What counts is at most ``sweep.width``, and all of it where a view is for hidden surface, which
    may be anywhere in it. Along the contour the known part of the target lies on one side of a
    viewpoint that faces the next segment; as much is expected on the other.
    """
    session, config = context.session, context.session.config
    if context.is_contour_done:
        return config.sweep.width / 2, False
    there = context.view.T_world_scan @ viewpoint
    seen = [view.T_world_scan.apply(view.target.points[::TARGET_STRIDE]) for view in session.views]
    return _measure_half(there.inverse().apply(np.concatenate(seen)), config)


def choose_sector(session: Session, viewpoint: Pose2) -> tuple[float | None, float]:
    """Return ``half_width`` and ``beyond`` [rad] of the next sweep, at ``viewpoint`` in ``odom``.

    They are those of the latest plan. Before the first view, a panorama shows too little to predict
    how well the next one will be registered on it: the sweep ends halfway between what shows the
    target and the whole, which it is if the target reaches beyond ``sweep.width``.
    """
    config = session.config
    if session.plans:
        return session.plans[-1].half_width, session.plans[-1].beyond
    if config.planning.sector == "whole":
        return None, 0.0
    half, is_shown = _measure_half(viewpoint.inverse().apply(session.hint), config)
    return (half + config.sweep.width / 2 + config.sweep.margin) / 2 if is_shown else None, 0.0


def _measure_half(points: FloatArray, config: Config) -> tuple[float, bool]:
    """Return half the angle [rad] of a sweep that shows the target's ``points`` and where it ends.

    Args:
        points: In the frame of the sweep (n, 2) or (n, 3) [m].
        config: ``sweep.width`` counts at most.

    Returns:
        The angle, and whether the target ends within what counts.
    """
    bearings = np.abs(np.arctan2(points[:, 1], points[:, 0]))
    beyond = config.target.cluster_gap / config.planning.standoff + FREE_ANGLE
    extent = float(np.max(bearings[bearings <= math.pi / 2], initial=0.0))
    most = config.sweep.width / 2
    return min(extent, most) + beyond, extent + beyond <= most
