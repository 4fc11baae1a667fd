"""The warnings of a report: what a reader must know before trusting the model."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from scan3d_twin.core.model.evaluation import Evaluation
from scan3d_twin.core.session import Session, View

MIN_RETURN_SHARE = 0.3
"""Share of readings with a return below which surfaces are dark, shiny or far (assumption)."""
MIN_TARGET_POINTS = 500
"""Fewest target points of a useful view: 2 % of what a sweep of 60 deg can show (assumption)."""
MIN_AMBIGUITY_GAP = 0.1
"""Least difference of score between two basins for a unique registration (assumption)."""


def find_warnings(session: Session, evaluation: Evaluation | None = None) -> list[str]:
    """Return one sentence for each problem of a run; an empty list for a good run."""
    if not session.views:
        return ["Nothing was scanned: there is no view."]
    found = [*_check_returns(session), *_check_fallbacks(session), *_check_registrations(session)]
    return [*found, *_check_misfits(session), *_check_errors(session, evaluation)]


def _check_returns(session: Session) -> Iterator[str]:
    for k, view in enumerate(session.views):
        share = _returned_share(view, session.config.target.window)
        if share < MIN_RETURN_SHARE:
            yield (
                f"View {k}: only {share:.0%} of the readings came back. Dark, shiny or transparent "
                "surfaces, or nothing within reach?"
            )
        if len(view.target) < MIN_TARGET_POINTS:
            yield f"View {k}: only {len(view.target)} points are of the target."


def _returned_share(view: View, window: float) -> float:
    """Return the share of the readings in the vertical ``window`` [rad] that are distances."""
    image = view.observation.image
    inside = np.abs(image.spec.elevations) <= window / 2
    return float(np.mean(np.isfinite(image.ranges[:, inside])))


def _check_fallbacks(session: Session) -> Iterator[str]:
    epsilon = session.config.planning.epsilon
    fallen = [
        (k + 1, plan)
        for k, plan in enumerate(session.plans)
        if plan.fell_back and plan.viewpoint is not None
    ]
    expected = [plan.predicted_rmse for _, plan in fallen if math.isfinite(plan.predicted_rmse)]
    if expected:
        yield (
            f"{1e3 * epsilon:g} mm is below the expected {1e3 * max(expected):.1f} mm, which the "
            "run accepted: this sensor does not reach it on this surface."
        )
    for view, plan in fallen:
        known = [c.predicted_rmse for c in plan.candidates if math.isfinite(c.predicted_rmse)]
        best = f" (best {1e3 * min(known):.1f} mm)" if known else ""
        yield (
            f"View {view}: no viewpoint was predicted to meet {1e3 * epsilon:g} mm{best}; an "
            f"overlap of {plan.overlap:.0%} was taken."
        )


def _check_registrations(session: Session) -> Iterator[str]:
    for k, view in enumerate(session.views):
        result = view.registration
        if result is None:
            continue
        if not result.converged:
            why = "they do not overlap" if result.num_inliers == 0 else "it did not converge"
            yield f"View {k} is not registered ({why}): its pose is that of the odometry alone."
            continue
        if result.ambiguity_gap < MIN_AMBIGUITY_GAP:
            yield f"View {k}: another place fits almost as well; compare it with its neighbours."
        if len(result.degenerate_directions):
            yield (
                f"View {k}: the surfaces leave {len(result.degenerate_directions)} direction(s) "
                "open, in which only odometry determines the pose. A bare wall or a round object?"
            )


def _check_misfits(session: Session) -> Iterator[str]:
    for k in session.misfits:
        yield (
            f"View {k} does not fit the others: most of its links contradict them. Inspect it, or "
            "drop it (alignment.misfits = drop)."
        )


def _check_errors(session: Session, evaluation: Evaluation | None) -> Iterator[str]:
    epsilon = session.config.planning.epsilon
    if evaluation is not None:
        for pair in evaluation.pairs:
            if pair.error > epsilon:
                yield (
                    f"View {pair.view}: registered {1e3 * pair.error:.1f} mm off its predecessor, "
                    f"more than the {1e3 * epsilon:g} mm wanted."
                )
        return
    for k, view in enumerate(session.views):
        result = view.registration
        if result is not None and result.converged and result.predicted_rmse > epsilon:
            yield (
                f"View {k}: its registration is expected to be off by "
                f"{1e3 * result.predicted_rmse:.1f} mm, more than the {1e3 * epsilon:g} mm wanted."
            )
