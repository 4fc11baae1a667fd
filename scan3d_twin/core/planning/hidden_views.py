"""Termination, and views of hidden surface in niches and gaps once the contour is complete.

The views along the outline come first, then those of what they could not see, as by P. S. Blaer and
P. K. Allen (View planning and automated data acquisition for three-dimensional modeling of complex
sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, stop_plan
from scan3d_twin.core.planning.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.hidden_surface import HiddenSurface
from scan3d_twin.core.planning.overlap_or_default import expect_accuracy
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.types import Plan, Pose2, wrap

MAX_TRIED = 20
"""Largest number of viewpoints whose error is predicted; the others show less surface."""
HALFWAY_SHARES = (0.75, 0.5, 0.25)
"""Shares of the way to a viewpoint at which a view in between is tried."""


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
    """Return the plan for the view of the most hidden surface; None if none is worth a view.

    Where the error of all viewpoints from which it shows exceeds the accuracy that the run keeps
    (``expect_accuracy``), it goes part of the way: the next view is then registered on the one that
    is taken there.
    """
    # Rank viewpoints by hidden surface
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = HiddenSurface(session).measure_areas(candidates.poses)

    # Take the first that meets epsilon
    try:
        prediction = ErrorPrediction.of(context)
    except RegistrationError:
        return None
    here, accuracy = context.view.T_world_scan, expect_accuracy(session)
    order = np.argsort(-areas, kind="stable")
    wanted = [int(i) for i in order[areas[order] >= config.least_hidden][:MAX_TRIED]]
    for i in wanted:
        pose = candidates.poses[i]
        if prediction.error(here.inverse() @ pose) <= accuracy:
            return _go(candidates, pose, f"contour done: {1e4 * areas[i]:.0f} cm2 more may show")

    # Else go part of the way to one
    for i in wanted:
        for pose in _iterate_halfway(here, candidates.poses[i]):
            step = here.inverse() @ pose
            is_possible = candidates.is_allowed(pose) and context.is_feasible(step)
            if is_possible and prediction.error(step) <= accuracy:
                reason = f"contour done: on the way to {1e4 * areas[i]:.0f} cm2 more"
                return _go(candidates, pose, reason)
    return None


def _iterate_halfway(here: Pose2, there: Pose2) -> Iterator[Pose2]:
    """Yield poses between two, the farthest first."""
    turn = wrap(there.yaw - here.yaw)
    for share in HALFWAY_SHARES:
        yield Pose2(
            here.x + share * (there.x - here.x),
            here.y + share * (there.y - here.y),
            here.yaw + share * turn,
        )


def _go(candidates: PoseCandidates, pose: Pose2, reason: str) -> Plan:
    """Return the plan to go to ``pose``, which falls back if its error exceeds epsilon."""
    plan = candidates.go(pose, reason)
    fell_back = plan.predicted_rmse > candidates.session.config.planning.epsilon
    return replace(plan, fell_back=fell_back)
