"""The overlap of the next view: the smallest one that meets epsilon, else what comes nearest to it.

Paper section 5, eq. (4) and the pseudo-code. All planners that choose an overlap, and not a pose,
build their plans here. Where no overlap meets epsilon from straight ahead, the paper takes 80 %,
whatever it predicts; with ``planning.fallback = best`` viewpoints that are turned off the segment's
normal are tried, from which a corner may show both of its faces, and of all the one with the least
error is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from statistics import median

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, blocked_plan, to_world
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan, Pose2
from scan3d_twin.core.viewpoints import sum_turns

STEP_SHARES = (0.75, 0.5)
"""Shares of the step with the largest overlap that are tried where it does not meet epsilon."""
ErrorOf = Callable[[float, Pose2], float]
"""Returns the error [m] of an overlap and its viewpoint in frame ``scan``."""


def list_overlaps(config: PlanningConfig) -> list[float]:
    """Return the overlaps eta to try, smallest first."""
    steps = math.floor((config.eta_max - config.eta_min) / config.eta_step + 1e-9)
    return [round(config.eta_min + k * config.eta_step, 9) for k in range(steps + 1)]


def plan_smallest_overlap(context: PlanningContext, error: ErrorOf) -> Plan:
    """Return the plan for the smallest overlap whose error meets epsilon, eq. (4).

    Args:
        context: A tour that is not finished.
        error: Returns the error [m] of an overlap and its viewpoint in frame ``scan``.
    """
    config = context.session.config.planning
    candidates: list[Candidate] = []
    for eta in list_overlaps(config):
        # Find the viewpoint of this overlap
        placement = context.find_placement(eta)
        if not placement.is_wanted and not context.has_panorama:
            return blocked_plan(context)
        if placement.viewpoint is None:
            continue

        # Accept it if it meets epsilon
        viewpoint, E = to_world(context, placement.viewpoint), error(eta, placement.viewpoint)
        candidates.append(Candidate(viewpoint, eta, E, feasible=True))
        if config.epsilon >= E:
            return _plan_for(candidates[-1], candidates, fell_back=False)

    # Else take what comes nearest to it
    if config.fallback == "best":
        return _plan_best(context, candidates, error)
    return _plan_default_overlap(context, candidates, config)


def plan_with_overlap(
    context: PlanningContext, overlap: float, reason: str, tried: Iterable[Candidate] = ()
) -> Plan:
    """Return the plan to go on with a given ``overlap``.

    Args:
        context: A tour that is not finished.
        overlap: The paper's eta.
        reason: Why this overlap, in words.
        tried: Candidates that were considered before.
    """
    placement = context.find_placement(overlap)
    if placement.viewpoint is None or not (placement.is_wanted or context.has_panorama):
        return blocked_plan(context)
    error = predict_error(context, placement.viewpoint)
    viewpoint = to_world(context, placement.viewpoint)
    candidate = Candidate(viewpoint, overlap, error, feasible=True)
    return Plan(viewpoint, overlap, error, False, (*tried, candidate), reason)


def predict_error(context: PlanningContext, viewpoint: Pose2) -> float:
    """Return the closed-form prediction [m] for ``viewpoint``, given in ``scan``.

    It judges the viewpoints of planners that ignore registration, too.

    Returns:
        Infinity without overlap, NaN where the latest view shows too little surface.
    """
    try:
        return ErrorPrediction.of(context).error(viewpoint)
    except RegistrationError:
        return math.nan


def expect_accuracy(session: Session) -> float:
    """Return the accuracy [m] that the run keeps: epsilon, or the median error it has accepted.

    A plan that fell back was carried out although its predicted error exceeds epsilon. The first
    ones may exceed it by far, before the errors of the robot are learned.
    """
    accepted = (plan.predicted_rmse for plan in session.plans if plan.fell_back)
    known = [error for error in accepted if math.isfinite(error)]
    return max(session.config.planning.epsilon, median(known) if known else 0.0)


def describe_shortfall(plan: Plan, epsilon: float) -> str | None:
    """Return in words that ``plan`` is not expected to meet ``epsilon`` [m]; None if it is."""
    if not plan.fell_back or plan.viewpoint is None:
        return None
    wanted = f"{1e3 * epsilon:g} mm"
    if not math.isfinite(plan.predicted_rmse):
        return f"{wanted} cannot be expected: too little surface is in sight to predict the error"
    return f"{wanted} is below the expected {1e3 * plan.predicted_rmse:.1f} mm"


def _plan_best(context: PlanningContext, straight: list[Candidate], error: ErrorOf) -> Plan:
    """Return the plan for the smallest overlap with an oblique viewpoint within epsilon.

    If there is none, a shorter step within epsilon is taken, and else the candidate with the least
    error; the more of the ``max_views`` are used up for less of the way, the more above it is
    accepted for a longer step, so that a wish that cannot be met does not cost the model. Where no
    error can be predicted, it is the default overlap.

    Args:
        context: A tour that is not finished.
        straight: The candidates that were tried before.
        error: See ``plan_smallest_overlap``.
    """
    # Try oblique viewpoints
    config, candidates = context.session.config.planning, list(straight)
    if any(math.isfinite(candidate.predicted_rmse) for candidate in straight):
        for eta in list_overlaps(config):
            tried = [
                Candidate(to_world(context, viewpoint), eta, error(eta, viewpoint), feasible=True)
                for viewpoint in context.find_oblique_viewpoints(eta)
            ]
            if tried:
                candidates.append(min(tried, key=lambda candidate: candidate.predicted_rmse))
                if candidates[-1].predicted_rmse <= config.epsilon:
                    return _plan_for(candidates[-1], candidates, fell_back=False)

    # Try shorter steps
    if math.isfinite(_find_least_error(candidates)):
        for candidate in _iterate_shorter_steps(context, tuple(candidates), error):
            candidates.append(candidate)
            if candidate.predicted_rmse <= config.epsilon:
                return _plan_for(candidate, candidates, fell_back=False)

    # Take the least error, or a longer step if few views are left
    least = _find_least_error(candidates)
    if not math.isfinite(least):
        return _plan_default_overlap(context, candidates, config)
    accepted = least * (1.0 + _measure_lag(context.session))
    best = min(
        (candidate for candidate in candidates if candidate.predicted_rmse <= accepted),
        key=lambda candidate: (candidate.overlap, candidate.predicted_rmse),
    )
    reason = f"no viewpoint meets epsilon: {best.overlap:.0%} comes near the least expected error"
    return _plan_for(best, candidates, fell_back=True, reason=reason)


def _find_least_error(candidates: Iterable[Candidate]) -> float:
    """Return the least predicted error [m]; infinite where there is none."""
    return min((candidate.predicted_rmse for candidate in candidates), default=math.inf)


def _measure_lag(session: Session) -> float:
    """Return by which share of its views, 0..1, a tour is late; of the front: all it has taken."""
    used = len(session.views) / session.config.max_views
    return used if session.config.tour == "front" else max(used - _measure_progress(session), 0.0)


def _measure_progress(session: Session) -> float:
    """Return the share of the way round that the views have turned, 0..1."""
    turned = sum_turns(view.T_world_scan for view in session.views)
    return min(abs(turned) / math.tau, 1.0)


def _iterate_shorter_steps(
    context: PlanningContext, tried: Iterable[Candidate], error: ErrorOf
) -> Iterator[Candidate]:
    """Yield candidates part of the way to the one of those ``tried`` with the largest overlap.

    Round a small thing even the largest overlap may be a turn of 50 deg, as its few lines say
    little of the direction of its faces. A step is only so short that the views left are enough to
    go all round with such steps.
    """
    config, session = context.session.config, context.session
    if config.tour != "full":
        return

    # Share out what is left of the round
    left = math.tau * (1.0 - _measure_progress(session))
    least_turn = left / max(config.max_views - len(session.views), 1)
    widest = max(tried, key=lambda candidate: candidate.overlap)
    step = context.view.T_world_scan.inverse() @ widest.viewpoint

    # Go part of the way
    for share in STEP_SHARES:
        short = Pose2(share * step.x, share * step.y, share * step.yaw)
        if abs(short.yaw) >= least_turn and context.is_feasible(short):
            overlap = 1.0 - share * (1.0 - widest.overlap)
            yield Candidate(to_world(context, short), overlap, error(overlap, short), feasible=True)


def _plan_default_overlap(
    context: PlanningContext, candidates: list[Candidate], config: PlanningConfig
) -> Plan:
    """Return the plan for a featureless surface: the default overlap (80 %), whatever its error."""
    placement = context.find_placement(config.default_overlap)
    if placement.viewpoint is None:
        return blocked_plan(context)
    error = next(
        (c.predicted_rmse for c in candidates if c.overlap == config.default_overlap), math.nan
    )
    viewpoint = to_world(context, placement.viewpoint)
    default = Candidate(viewpoint, config.default_overlap, error, feasible=True)
    return _plan_for(default, candidates, fell_back=True)


def _plan_for(
    candidate: Candidate, candidates: list[Candidate], fell_back: bool, reason: str = ""
) -> Plan:
    """Return the plan to go to ``candidate``; the ``reason`` is that of the paper by default."""
    reason = reason or (
        f"no overlap meets epsilon: default {candidate.overlap:.0%}"
        if fell_back
        else f"smallest overlap that meets epsilon: {candidate.overlap:.0%}"
    )
    return Plan(
        candidate.viewpoint,
        candidate.overlap,
        candidate.predicted_rmse,
        fell_back,
        tuple(candidates),
        reason,
    )
