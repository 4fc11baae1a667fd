"""The sections of ``report.html``; each function renders one as HTML."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import Any

from scan3d_twin.core.model.evaluation import Evaluation
from scan3d_twin.core.model.fused_cloud import measure_scanned_share
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.run.report import Report
from scan3d_twin.viz.pages.charts import Chart, Dot, render_chart, round_up
from scan3d_twin.viz.pages.page import Cell, render_table

MAX_CHART_ERROR = 5.0
"""Largest error of a chart, in units of epsilon; larger ones are arrows at the edge."""


def render_head(report: Report) -> str:
    """Return the title, the stop reason and the key figures."""
    # Collect the key figures
    figures = [
        ("Views", f"{report['views']}", ""),
        *_quality(report),
        ("Wanted error ε", f"{report['epsilon_mm']:g}", "mm"),
        ("Points", f"{report['points']:,}".replace(",", "\N{THIN SPACE}"), ""),
        ("Driven", f"{report['path_m']:.1f}", "m"),
        ("Robot's time", _duration(report["sim_time_s"]), ""),
    ]
    cells = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)} <small>{escape(unit)}</small></dd></div>"
        for name, value, unit in figures
    )

    # Return the header of the page
    return (
        f"<header><h1>{escape(report['scene'])}</h1>"
        f'<p class="lead">{escape(_capital(report["stop_reason"]))}. '
        f"Planner {escape(report['planner'])}, preset {escape(report['preset'])}, "
        f"robot {escape(report['robot'])}, seed {report['seed']}.</p>"
        f'<dl class="figures">{cells}</dl></header>'
    )


def _quality(report: Report) -> list[tuple[str, str, str]]:
    """Return the figures that need the ground truth."""
    if report["coverage_20mm"] is None:
        return []
    figures = [
        ("Surface covered (20 mm)", f"{report['coverage_20mm']:.0%}", ""),
        ("Accuracy (median)", f"{report['accuracy_mm']['median']:.1f}", "mm"),
    ]
    worst = report["max_registration_error_mm"]
    if worst is not None:
        figures.append(("Worst registration", f"{worst:.1f}", "mm"))
    return figures


def render_warnings(found: Sequence[str]) -> str:
    """Return the warnings of the report."""
    if not found:
        return '<p class="fine">Nothing to warn of: all views are registered as wanted.</p>'
    items = "".join(f"<li>{escape(each)}</li>" for each in found)
    return (
        f'<div class="warnings"><strong>Before you trust this model</strong><ul>{items}</ul></div>'
    )


def render_top_view(document: str, *, known: bool) -> str:
    """Return the top view, as an image so that its style sheet does not affect the page.

    Args:
        document: The picture as SVG.
        known: Whether the truth is known, and in the picture.
    """
    words = (
        "Points coloured by view, a numbered star at each viewpoint, its scan sector dashed. The "
        "sectors end a quarter beyond the planned distance: the lidar sees farther, so that points "
        "may lie outside. Arrows show the way that was driven"
        + (", grey the true shape from above." if known else ".")
    )
    return render_drawing("Top view", document, words)


def render_drawing(title: str, document: str, words: str) -> str:
    """Return a section with a top view, the SVG ``document``, and ``words`` below it."""
    data = base64.b64encode(document.encode()).decode()
    return (
        f'<h2>{title}</h2><figure><div class="frame"><img class="tall" id="top-view" '
        f'alt="Top view" src="data:image/svg+xml;base64,{data}"></div>'
        f"<figcaption>{words}</figcaption></figure>"
    )


def render_views(report: Report, session: Session) -> str:
    """Return the table of views: planned overlap, predicted and realised errors."""
    if not session.views:
        return ""

    # Fill the rows
    known = report["coverage_20mm"] is not None
    rows = {row["view"]: row for row in report["registration"]}
    names = ["View", "Points", "Overlap", "Predicted error"]
    names += ["Realised error", "By odometry alone"] if known else []
    names += ["Odometry corrected by", "Fitness", "Note"]
    cells = [_cells(k, session, rows.get(k), known=known) for k in range(len(session.views))]

    # Return the table with legend
    return (
        f"<h2>Views</h2>{render_table(names, cells, remark='Note')}"
        '<p class="note">Errors are root mean square over the view\'s target points, against the '
        "view before; orange is more than ε. Predicted by the planner before the move"
        + (", realised as only a simulator can know." if known else ".")
        + "</p>"
    )


def _cells(k: int, session: Session, row: dict[str, Any] | None, *, known: bool) -> list[Cell]:
    dash, epsilon = "\N{EN DASH}", 1e3 * session.config.planning.epsilon
    points = f"{len(session.views[k].target):,}".replace(",", "\N{THIN SPACE}")
    first = [(f'<span class="swatch" style="background:{view_colour(k)}"></span>{k}', False)]
    first.append((points, False))
    if row is None:
        return [*first, *[(dash, False)] * (6 if known else 4), ("the first", False)]

    def cell(key: str, form: str = "{:.1f} mm", *, judged: bool = False) -> Cell:
        value = row[key]
        return (dash, False) if value is None else (form.format(value), judged and value > epsilon)

    cells = [*first, cell("overlap", "{:.0%}"), cell("predicted_rmse_mm", judged=True)]
    if known:
        cells += [cell("error_mm", judged=True), cell("odometry_error_mm")]
    moved, turned = row["correction_mm"], row["correction_deg"]
    corrected = (dash if moved is None else f"{moved:.1f} mm, {turned:.2f}°", False)
    return [*cells, corrected, cell("fitness", "{:.0%}"), (escape(_note(row)), False)]


def _note(row: dict[str, Any]) -> str:
    notes = [] if row["converged"] else ["not registered: placed by odometry"]
    return "; ".join(notes + (["above epsilon"] if row["fell_back"] else []))


def render_overlap_curves(session: Session) -> str:
    """Return a chart E(eta) for each planning step that predicted errors."""
    # Select steps with a prediction
    epsilon = 1e3 * session.config.planning.epsilon
    steps = [
        (k, plan)
        for k, plan in enumerate(session.plans)
        if any(not math.isnan(c.predicted_rmse) for c in plan.candidates)
    ]
    if not steps:
        return ""

    # Find a common scale
    finite = [
        1e3 * c.predicted_rmse
        for _, plan in steps
        for c in plan.candidates
        if math.isfinite(c.predicted_rmse)
    ]
    top = round_up(min(MAX_CHART_ERROR * epsilon, 1.1 * max([epsilon, *finite])))

    # Draw one chart per step
    charts = "".join(
        _overlap_curve(k, plan, epsilon, top) for k, plan in steps if len(plan.candidates) > 1
    )
    at_once = "; ".join(
        f"view {k} to {k + 1}: {plan.overlap:.0%} at {_millimetres(plan.predicted_rmse)}"
        for k, plan in steps
        if len(plan.candidates) == 1
    )

    # Return the section with charts
    return (
        "<h2>How the overlaps were chosen</h2><p>For each step the planner predicts the "
        "registration error E of growing overlaps η and takes the smallest that stays within ε "
        "(filled dot); if none does, the best.</p>"
        f'<div class="charts">{charts}</div>'
        + (f"<p>The first overlap tried was enough for {at_once}.</p>" if at_once else "")
    )


def _overlap_curve(k: int, plan: Plan, epsilon: float, top: float) -> str:
    # Make one dot per candidate
    chosen = plan.viewpoint is not None
    dots = [
        Dot(
            c.overlap,
            1e3 * c.predicted_rmse,
            view_colour(k),
            filled=chosen and abs(c.overlap - plan.overlap) < 1e-9,
            title=f"overlap {c.overlap:.0%}: {_millimetres(c.predicted_rmse)}",
        )
        for c in sorted(plan.candidates, key=lambda c: c.overlap)
        if not math.isnan(c.predicted_rmse)
    ]

    # Draw the chart
    words = f"{plan.overlap:.0%}" + (" (above ε)" if plan.fell_back else "")
    title = f"View {k} to {k + 1}: {words}" if chosen else f"View {k}: the last"
    chart = Chart(
        f"{title}: predicted error against overlap",
        "overlap η",
        "E [mm]",
        (0.0, 1.0),
        (0.0, top),
        dots,
        limit=epsilon,
        limit_label=f"ε = {epsilon:g} mm",
        percent="x",
        width=330,
        height=220,
        colour=view_colour(k),
    )
    return f"<figure><h3>{escape(title)}</h3>{render_chart(chart)}</figure>"


def render_coverage(session: Session, evaluation: Evaluation | None, end: float) -> str:
    """Return the chart of coverage against time until the ``end`` of the run [s].

    Each view is a numbered dot.
    """
    if not session.views:
        return ""

    # Compute coverage after each view
    if evaluation is not None:
        shares: Sequence[float] = evaluation.coverage_by_view
        title, label = "Surface coverage", "covered"
        what = "Share of the surface in reach of the lidar that lies within 20 mm of the model"
    else:
        shares = [
            measure_scanned_share(replace(session, views=session.views[: k + 1]))
            for k in range(len(session.views))
        ]
        title, label = "Outline", "scanned"
        what = "Share of the target's outline in top view, as far as the robot knows it, scanned"
    times = [float(view.observation.image.stamps.max()) for view in session.views]
    end = max(end, times[-1])
    scale, unit = (1.0, "s") if end < 600 else (60.0, "min")
    dots = [
        Dot(time / scale, share, view_colour(k), f"{k}", title=f"after view {k}: {share:.1%}")
        for k, (time, share) in enumerate(zip(times, shares, strict=True))
    ]
    chart = Chart(
        f"{title} against time",
        f"time on the robot's clock [{unit}]",
        label,
        (0.0, end / scale),
        (0.0, 1.0),
        dots,
        percent="y",
        width=520,
        height=260,
    )

    # Return the chart with caption
    return (
        f'<h2>{title}</h2><figure class="wide">{render_chart(chart)}<figcaption>{what}, '
        "at the end of each view, which is numbered.</figcaption></figure>"
    )


def render_scene(picture: bytes) -> str:
    """Return the picture of the scene, a PNG; nothing without one."""
    if not picture:
        return ""
    data = base64.b64encode(picture).decode()
    return (
        '<h2>Scene</h2><figure><div class="frame"><img alt="The scene with the robot at its start"'
        f' src="data:image/png;base64,{data}"></div>'
        "<figcaption>The twin's scene, with the robot where it started.</figcaption></figure>"
    )


def render_options(settings_toml: str) -> str:
    """Return the effective options, collapsed on a screen."""
    return (
        "<h2>Options</h2><details><summary>All effective options, to run it again</summary>"
        f"<pre>{escape(settings_toml)}</pre></details>"
    )


def render_foot(report: Report) -> str:
    """Return the footer: version and units."""
    return (
        f"<footer>scan3d_twin {escape(report['version'])}; all lengths in metres unless said "
        "otherwise; the numbers are in report.json, the cloud in model.ply.</footer>"
    )


def _millimetres(metres: float) -> str:
    return f"{1e3 * metres:.1f} mm" if math.isfinite(metres) else "no registration"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} min" if minutes else f"{rest} s"


def _capital(text: str) -> str:
    """Return ``text`` with a capital first letter, on one line, without its full stop."""
    text = re.sub(r"\s+", " ", text).rstrip(".")
    return text[:1].upper() + text[1:]
