"""Views after the contour is done, for what it spans: niches, and gaps between a target's parts.

First the views that the outline asks for, then those for what these could not see, as P. S. Blaer
and P. K. Allen do it (View planning and automated data acquisition for three-dimensional modeling
of complex sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, finish
from scan3d_twin.core.planning.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.hidden_surface import Hidden
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.types import Plan

MOST_TRIED = 20
"""Viewpoints whose error is predicted; the rest show less."""


def termination_plan(context: PlanningContext) -> Plan | None:
    """Return the plan for when there is no next step along the contour; None while there is one.

    It ends the run, or goes where most of what the target hides may show, if ``planning.closing``
    wants that and the predicted error meets epsilon.
    """
    reason = context.finished()
    if reason is None:
        return None
    wanted = context.session.config.planning.closing == "hidden"
    if not (wanted and context.going and context.contour_done):
        return finish(reason)
    return _closing_view(context) or finish(reason)


def _closing_view(context: PlanningContext) -> Plan | None:
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = Hidden(session).areas(candidates.poses)
    try:
        forecast = ErrorPrediction.of(context)
    except RegistrationError:
        return None
    here = context.view.T_world_scan.inverse()
    order = np.argsort(-areas, kind="stable")
    for i in order[areas[order] >= config.least_hidden][:MOST_TRIED]:
        pose = candidates.poses[i]
        if forecast.error(here @ pose) <= config.epsilon:
            return candidates.go(pose, f"contour done: {1e4 * areas[i]:.0f} cm2 more may show")
    return None
