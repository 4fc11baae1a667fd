"""Termination, and views of hidden surface in niches and gaps once the contour is complete.

The views along the outline come first, then those of what they could not see, as by P. S. Blaer and
P. K. Allen (View planning and automated data acquisition for three-dimensional modeling of complex
sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, stop_plan
from scan3d_twin.core.planning.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.hidden_surface import HiddenSurface
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.types import Plan

MAX_TRIED = 20
"""Largest number of viewpoints whose error is predicted; the others show less surface."""


def termination_plan(context: PlanningContext) -> Plan | None:
    """Return the plan after the last step along the contour; None while there is a next step.

    It ends the run, unless ``planning.closing`` asks for views of hidden surface: then it goes
    where the most of it is expected to show with a predicted error that meets epsilon.
    """
    reason = context.termination_reason()
    if reason is None:
        return None
    wanted = context.session.config.planning.closing == "hidden"
    if not (wanted and context.is_ongoing and context.is_contour_done):
        return stop_plan(reason)
    return _plan_hidden_view(context) or stop_plan(reason)


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
