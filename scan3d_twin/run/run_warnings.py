"""The warnings of a report: what a reader must know before trusting the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from scan3d_twin.core.mapping.error_check import check_errors
from scan3d_twin.core.mapping.odometry_check import measure_turn_error
from scan3d_twin.core.model.evaluation import MIN_F_SCORE, Evaluation
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import UNMEASURED

MIN_RETURN_SHARE = 0.3
"""Share of readings with a return below which surfaces are dark, shiny or far (assumption)."""
MIN_TARGET_POINTS = 500
"""Fewest target points of a useful view: 2 % of what a sweep of 60 deg can show (assumption)."""
MIN_AMBIGUITY_GAP = 0.1
"""Least difference of score between two basins for a unique registration (assumption)."""


def find_warnings(
    session: Session, evaluation: Evaluation | None = None, notes: Sequence[str] = ()
) -> list[str]:
    """Return one sentence for each problem of a run; an empty list for a good run.

    Args:
        session: The run.
        evaluation: By the ground truth, where there is one and the model shows its target.
        notes: What is known about the scene, and about the model where it was not evaluated.
    """
    if not session.views:
        return [*notes, "Nothing was scanned: there is no view."]
    found = [*notes, *_check_returns(session), *_check_fallbacks(session)]
    found += _check_registrations(session)
    found += [*_check_misfits(session), *_check_odometry(session), *_check_assumptions(session)]
    found += _check_errors(session, evaluation)
    return found if evaluation is None else [*found, *_check_model(evaluation)]


def describe_doubts(session: Session) -> list[str]:
    """Return one sentence for each doubt about the place of a view, as the report has them."""
    return [
        *_check_registrations(session),
        *_check_misfits(session),
        *_check_errors(session, None),
    ]


class AssumptionCheck(Unobserved):
    """Warns once, as soon as views show that the odometry is wrong or errors are large."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self._untold = [_check_odometry, _check_assumptions]

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        for check in tuple(self._untold):
            for words in check(session):
                self._untold.remove(check)
                self._notify(f"warning: {words}")


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
    inside = (np.abs(image.elevation_rows) <= window / 2) & (image.codes != UNMEASURED)
    return float(np.mean(np.isfinite(image.ranges[inside])))


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
            apart = "they do not overlap or contradict each other"
            why = apart if result.num_inliers == 0 else "it did not converge"
            yield f"View {k} is not registered ({why}): its pose is that of the odometry alone."
            continue
        if result.ambiguity_gap < MIN_AMBIGUITY_GAP:
            unsure = ":" if view.observation.has_odometry else " is unsure:"
            yield (
                f"View {k}{unsure} another place fits almost as well; compare it with its "
                "neighbours."
            )
        if len(result.degenerate_directions):
            determines = (
                "only odometry determines the pose"
                if view.observation.has_odometry
                else "nothing determines the pose"
            )
            yield (
                f"View {k}: the surfaces leave {len(result.degenerate_directions)} direction(s) "
                f"open, in which {determines}. A bare wall or a round object?"
            )


def _check_misfits(session: Session) -> Iterator[str]:
    for k in session.misfits:
        yield (
            f"View {k} does not fit the others: most of its links contradict them. Inspect it, or "
            "drop it (alignment.misfits = drop)."
        )


def _check_odometry(session: Session) -> Iterator[str]:
    error = measure_turn_error(session)
    if error.is_significant:
        yield str(error)


def _check_assumptions(session: Session) -> Iterator[str]:
    found = check_errors(session)
    if found.findings:
        yield str(found)


def _check_model(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.coverable_share == 0:
        yield (
            "Nothing of the target can be seen from where the robot can stand, so its coverage "
            "counts as 0: is it hidden, out of reach, or shut off from the robot's start?"
        )
    score = evaluation.f_score[0.020]
    if score < MIN_F_SCORE:
        yield (
            f"The model is not that of the target (F-score {score:.2f} at 20 mm): it shows other "
            "things too, or little of the target."
        )
    if evaluation.left_out:
        yield (
            f"The scene has other targets: {', '.join(evaluation.left_out)}. This model is judged "
            f"by {', '.join(evaluation.targets)}; --target chooses, --targets N scans several."
        )


def _check_errors(session: Session, evaluation: Evaluation | None) -> Iterator[str]:
    config = session.config
    wanted = f"more than the {1e3 * config.planning.epsilon:g} mm wanted"

    # As far as the run itself knows
    excess = check_errors(session).excess
    for k, view in enumerate(session.views):
        result = view.registration
        if result is None:
            continue
        expected = excess * config.registration.calibration * result.predicted_rmse
        if config.planning.epsilon < expected < math.inf:
            yield (
                f"View {k}: its pose may be off by {1e3 * expected:.1f} mm (90 % of such poses are "
                f"off by less), {wanted}."
            )

    # By the truth
    for pair in () if evaluation is None else evaluation.pairs:
        if pair.error > config.planning.epsilon:
            yield (
                f"View {pair.view}: registered {1e3 * pair.error:.1f} mm off its predecessor, "
                f"{wanted}."
            )
