"""Views after the contour is done, for what it spans: niches, and gaps between a target's parts.

First the views that the outline asks for, then those for what these could not see, as P. S. Blaer
and P. K. Allen do it (View planning and automated data acquisition for three-dimensional modeling
of complex sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import Situation, finish
from scan3d_twin.core.planning.error_prediction import Forecast
from scan3d_twin.core.planning.hidden_surface import Hidden
from scan3d_twin.core.planning.pose_candidates import Prospects
from scan3d_twin.core.types import Plan

MOST_TRIED = 20
"""Viewpoints whose error is predicted; the rest show less."""


def over(situation: Situation) -> Plan | None:
    """Return the plan for when there is no next step along the contour; None while there is one.

    It ends the run, or goes where most of what the target hides may show, if ``planning.closing``
    wants that and the predicted error meets epsilon.
    """
    reason = situation.finished()
    if reason is None:
        return None
    wanted = situation.session.config.planning.closing == "hidden"
    if not (wanted and situation.going and situation.contour_done):
        return finish(reason)
    return _closing_view(situation) or finish(reason)


def _closing_view(situation: Situation) -> Plan | None:
    session, config = situation.session, situation.session.config.planning
    prospects = Prospects.on(situation)
    areas = Hidden(session).areas(prospects.poses)
    try:
        forecast = Forecast.of(situation)
    except RegistrationError:
        return None
    here = situation.view.T_world_scan.inverse()
    order = np.argsort(-areas, kind="stable")
    for i in order[areas[order] >= config.least_hidden][:MOST_TRIED]:
        pose = prospects.poses[i]
        if forecast.error(here @ pose) <= config.epsilon:
            return prospects.go(pose, f"contour done: {1e4 * areas[i]:.0f} cm2 more may show")
    return None
