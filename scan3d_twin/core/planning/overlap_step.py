"""One step along the contour with a chosen overlap, and what it is predicted to cost."""

from __future__ import annotations

import math
from collections.abc import Iterable

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, blocked, in_world
from scan3d_twin.core.planning.error_prediction import ErrorPrediction
from scan3d_twin.core.types import Candidate, Plan, Pose2


def predicted_error(context: PlanningContext, viewpoint: Pose2) -> float:
    """Return the closed-form prediction [m] for ``viewpoint``, given in ``scan``.

    Planners that do not think of registration are judged by it too. Infinite without overlap, NaN
    where the latest view shows too little to say.
    """
    try:
        return ErrorPrediction.of(context).error(viewpoint)
    except RegistrationError:
        return math.nan


def plan_with_overlap(
    context: PlanningContext, overlap: float, reason: str, tried: Iterable[Candidate] = ()
) -> Plan:
    """Return the plan to go on with ``overlap``.

    Args:
        context: Not finished.
        overlap: The paper's eta.
        reason: Why this overlap, in words.
        tried: What was considered before.
    """
    placement = context.place(overlap)
    if placement.viewpoint is None or not (placement.wanted or context.looked):
        return blocked(context)
    error = predicted_error(context, placement.viewpoint)
    viewpoint = in_world(context, placement.viewpoint)
    candidate = Candidate(viewpoint, overlap, error, feasible=True)
    return Plan(viewpoint, overlap, error, False, (*tried, candidate), reason)
