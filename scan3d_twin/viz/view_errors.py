"""Predicted beside realised error of each view of a recorded run."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scan3d_twin.core.model.pose_errors import measure_view_error
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.session import Session
from scan3d_twin.recording.load import RecordedRun, run_folder
from scan3d_twin.recording.overview.listing import REPORT, read_report_or_state


@dataclass(frozen=True, slots=True)
class ViewError:
    """The errors of the registration of one view.

    Attributes:
        view: Number of the view.
        predicted: Error predicted by the plan that led to it [mm]; NaN if unknown.
        realised: Error against the ground truth [mm]; NaN without one.
    """

    view: int
    predicted: float
    realised: float


def read_view_errors(run: RecordedRun) -> tuple[ViewError, ...]:
    """Return the errors of the views of ``run`` but the first, the realised ones of its report."""
    report, _ = read_report_or_state(run_folder(run.path) / REPORT)
    known = {row["view"]: row.get("error_mm") for row in report.get("registration", [])}
    realised = {k: math.nan if error is None else float(error) for k, error in known.items()}
    return list_view_errors(run.session, realised)


def measure_view_errors(session: Session, truth: Truth) -> dict[int, float]:
    """Return the realised error [mm] of each view of ``session`` but the first, by its number."""
    return {k: 1e3 * measure_view_error(k, session, truth) for k in range(1, len(session.views))}


def list_view_errors(session: Session, realised: dict[int, float]) -> tuple[ViewError, ...]:
    """Return the errors of the views of ``session`` but the first, with the ``realised`` [mm]."""
    return tuple(
        ViewError(k, 1e3 * session.plans[k - 1].predicted_rmse, realised.get(k, math.nan))
        for k in range(1, len(session.views))
        if k <= len(session.plans)
    )


def format_view_errors(errors: tuple[ViewError, ...], epsilon: float) -> str:
    """Return ``errors`` as a table in Markdown, bold above ``epsilon`` [m]; empty for none.

    The realised errors have no column where none is known.
    """
    if not errors:
        return ""
    known = any(math.isfinite(each.realised) for each in errors)
    rows = ["| view | predicted error |" + (" realised |" if known else "")]
    rows.append("|---:|---:|" + ("---:|" if known else ""))
    for each in errors:
        row = f"| {each.view} | {_format(each.predicted, epsilon)} |"
        rows.append(row + (f" {_format(each.realised, epsilon)} |" if known else ""))
    return "\n".join(rows)


def _format(error: float, epsilon: float) -> str:
    """Return ``error`` [mm] as text."""
    if not math.isfinite(error):
        return "unknown"
    bold = "**" if error > 1e3 * epsilon else ""
    return f"{bold}{error:.1f} mm{bold}"
