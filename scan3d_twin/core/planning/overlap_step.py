"""One step along the contour with a chosen overlap, and what it is predicted to cost."""

from __future__ import annotations

import math
from collections.abc import Iterable

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import Situation, blocked, in_world
from scan3d_twin.core.planning.error_prediction import Forecast
from scan3d_twin.core.types import Candidate, Plan, Pose2


def predicted_error(situation: Situation, viewpoint: Pose2) -> float:
    """Return the closed-form prediction [m] for ``viewpoint``, given in ``scan``.

    Planners that do not think of registration are judged by it too. Infinite without overlap, NaN
    where the latest view shows too little to say.
    """
    try:
        return Forecast.of(situation).error(viewpoint)
    except RegistrationError:
        return math.nan


def step(
    situation: Situation, overlap: float, reason: str, tried: Iterable[Candidate] = ()
) -> Plan:
    """Return the plan to go on with ``overlap``.

    Args:
        situation: Not finished.
        overlap: The paper's eta.
        reason: Why this overlap, in words.
        tried: What was considered before.
    """
    placement = situation.place(overlap)
    if placement.viewpoint is None or not (placement.wanted or situation.looked):
        return blocked(situation)
    error = predicted_error(situation, placement.viewpoint)
    viewpoint = in_world(situation, placement.viewpoint)
    candidate = Candidate(viewpoint, overlap, error, feasible=True)
    return Plan(viewpoint, overlap, error, False, (*tried, candidate), reason)
