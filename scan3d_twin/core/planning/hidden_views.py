"""Termination, and views of hidden surface in niches and gaps once the contour is complete.

The views along the outline come first, then those of what they could not see, as by P. S. Blaer and
P. K. Allen (View planning and automated data acquisition for three-dimensional modeling of complex
sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, stop_plan
from scan3d_twin.core.planning.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.hidden_surface import HiddenSurface
from scan3d_twin.core.planning.overlap_or_default import list_overlaps
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.types import Plan

BLOCKED_REASON = "no viewpoint left: none that shows the next segment can be reached"
"""Stop reason of a contour that goes on where the robot cannot."""
MIN_PROGRESS = 0.2
"""Least distance by which a view on the way is nearer to the wanted one [m]: grid_step."""
MAX_TRIED = 20
"""Largest number of viewpoints whose error is predicted; the others show less surface."""


def termination_plan(context: PlanningContext) -> Plan | None:
    """Return the plan after the last step along the contour; None while there is a next step.

    It ends the run, unless ``planning.closing`` asks for views of hidden surface: then it goes
    where the most of it is expected to show with a predicted error that meets epsilon. So it does
    where the contour goes on, but the robot cannot, as at a wall: the other end is hidden too.
    """
    # Look for an end of the contour
    reason = context.termination_reason()
    wanted = context.session.config.planning.closing == "hidden"
    if reason is None:
        if not (wanted and was_blocked(context)):
            return None
        return _plan_hidden_view(context) or _plan_approach(context) or stop_plan(BLOCKED_REASON)

    # Add views of hidden surface
    if not (wanted and context.is_ongoing and context.is_contour_done):
        return stop_plan(reason)
    return _plan_hidden_view(context) or stop_plan(reason)


def was_blocked(context: PlanningContext) -> bool:
    """Return whether no viewpoint of the next segment could be reached after any of the views.

    A panorama was taken before that is decided.
    """
    views = context.session.views
    return any(
        _is_blocked(PlanningContext(replace(context.session, views=views[:k])))
        for k in range(1, len(views) + 1)
        if any(taken == k for taken, _ in context.session.panoramas)
    )


def _is_blocked(context: PlanningContext) -> bool:
    config = context.session.config.planning
    overlaps = [*list_overlaps(config), config.default_overlap]
    return all(context.find_placement(eta).viewpoint is None for eta in overlaps)


def _plan_hidden_view(context: PlanningContext) -> Plan | None:
    """Return the plan for the view of the most hidden surface; None if none is worth a view."""
    # Rank viewpoints by hidden surface
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = HiddenSurface(session).measure_areas(candidates.poses)

    # Take the first that meets epsilon
    try:
        prediction = ErrorPrediction.of(context)
    except RegistrationError:
        return None
    here = context.view.T_world_scan.inverse()
    order = np.argsort(-areas, kind="stable")
    for i in order[areas[order] >= config.least_hidden][:MAX_TRIED]:
        pose = candidates.poses[i]
        if prediction.error(here @ pose) <= config.epsilon:
            return candidates.go(pose, f"contour done: {1e4 * areas[i]:.0f} cm2 more may show")
    return None


def _plan_approach(context: PlanningContext) -> Plan | None:
    """Return the plan for a view on the way to the most hidden surface; None if there is none.

    From the last view before the robot was blocked, the other end of the target is out of sight.
    The view nearest to the wanted one is taken whose predicted error meets epsilon.
    """
    # Choose the viewpoint to approach
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = HiddenSurface(session).measure_areas(candidates.poses)
    if np.max(areas, initial=0.0) < config.least_hidden:
        return None
    goal, here = candidates.poses[int(np.argmax(areas))], context.view.T_world_scan

    # Take the nearest view to it that can be registered
    try:
        prediction = ErrorPrediction.of(context)
    except RegistrationError:
        return None
    distances = np.array([pose.distance(goal) for pose in candidates.poses])
    order = np.argsort(distances, kind="stable")
    for i in order[distances[order] < here.distance(goal) - MIN_PROGRESS]:
        pose = candidates.poses[i]
        if prediction.error(here.inverse() @ pose) <= config.epsilon:
            return candidates.go(pose, "contour blocked: on the way to its other end")
    return None
