"""Several runs on one self-contained page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

from scan3d_twin.core.model.evaluation import Distances
from scan3d_twin.core.model.fused_cloud import join_models, measure_scanned_share
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.recording.overview.comparison import (
    MAX_DISTANCE,
    ComparedRun,
    find_differences,
    summarise,
)
from scan3d_twin.viz.pages.charts import Chart, Dot, Series, render_chart
from scan3d_twin.viz.pages.model_section import render_model
from scan3d_twin.viz.pages.packing import Mark, Shown
from scan3d_twin.viz.pages.page import Cell, render_page, render_table
from scan3d_twin.viz.pages.point_values import PointValues
from scan3d_twin.viz.pages.sections import render_drawing
from scan3d_twin.viz.top_view import draw_top_view

FULL_COLOUR = 0.02
"""Distance from the other model that has the last colour [m]: what counts as covered."""
_COLUMNS = (
    ("Views", "views", "{:d}"),
    ("Worst error", "max_registration_error_mm", "{:.1f} mm"),
    ("Accuracy (median)", "accuracy_median_mm", "{:.1f} mm"),
    ("Surface covered", "coverage_20mm", "{:.1%}"),
    ("Driven", "path_m", "{:.1f} m"),
    ("Robot's time", "sim_time_s", "{:.0f} s"),
)
"""Columns of the table of results: title, key of ``summarise``, and form."""


def render_compare_page(runs: Sequence[ComparedRun]) -> str:
    """Return the page of ``runs``, the first of which is the reference, as one HTML document."""
    shown = _show(runs)
    names = ", ".join(run.name for run in runs)
    parts = [
        f'<header><h1>{len(runs)} runs compared</h1><p class="lead">{escape(names)}</p></header>',
        _render_results(runs),
        _render_differences(runs),
        render_model(shown),
        _render_distances(runs),
        render_drawing("Tops over each other", _draw_tops(runs), "Points coloured by run."),
        _render_coverage(runs),
    ]
    return render_page("Runs compared", parts, summarise(runs), drawn=len(shown.model) > 0)


def _show(runs: Sequence[ComparedRun]) -> Shown:
    """Return the models over each other, each in the colour of its run."""
    models = [replace(run.model, view=np.full(len(run.model), k)) for k, run in enumerate(runs)]
    model = join_models(models)
    distances = 1e3 * np.concatenate([run.distances for run in runs])
    none = np.zeros((0, 3))
    return Shown(
        title="Runs",
        groups=tuple(run.name for run in runs),
        marks=tuple(
            Mark(k, run.T_first_own @ view.T_world_scan, run.session.config.sweep.width)
            for k, run in enumerate(runs)
            for view in run.session.views
        ),
        model=model,
        values=(PointValues("distance to the first", "mm", distances, 0.0, 1e3 * FULL_COLOUR),),
        around=none,
        missing=none,
        mesh=Mesh(none, np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)),
    )


def _render_results(runs: Sequence[ComparedRun]) -> str:
    rows = [
        [_named(k, run), *(_cell(results.get(key), form) for _, key, form in _COLUMNS),
         (escape(str(results.get("stop_reason", ""))), False)]
        for k, (run, results) in enumerate(zip(runs, summarise(runs)["runs"], strict=True))
    ]  # fmt: skip
    names = ["Run", *(title for title, _, _ in _COLUMNS), "Ended"]
    return f"<h2>Results</h2>{render_table(names, rows, remark='Ended')}"


def _render_differences(runs: Sequence[ComparedRun]) -> str:
    """Return the options that differ, a column a run."""
    found = find_differences(runs)
    if not found:
        return "<h2>Options</h2><p>All options are the same.</p>"
    rows = [
        [
            (f"<code>{escape(key)}</code>", False),
            *((escape(_text(value)), False) for value in values),
        ]
        for key, values in found.items()
    ]
    names = ["Option", *(run.name for run in runs)]
    return f"<h2>Options that differ</h2>{render_table(names, rows)}"


def _text(value: Any) -> str:
    if value is None:
        return "\N{EN DASH}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _render_distances(runs: Sequence[ComparedRun]) -> str:
    """Return the statistics of the distances from each model to the first one."""
    rows = [
        [
            _named(k, run),
            (escape(runs[1 if k == 0 else 0].name), False),
            *_statistics(run.apart),
            (f"{run.in_both:.0%}", False),
        ]
        for k, run in enumerate(runs)
    ]
    limit = f"{100 * MAX_DISTANCE:g} cm"
    names = ["Run", "To", "Median", "Mean", "95 %", f"Within {limit}"]
    return (
        f"<h2>Cloud to cloud</h2>{render_table(names, rows)}"
        '<p class="note">Distance from each point of a model to the nearest of the other, both in '
        f"voxels of 1 cm, laid on each other by registration; farther than {limit} is not counted. "
        "Spacing of the points alone makes 3 to 5 mm.</p>"
    )


def _statistics(apart: Distances | None) -> list[Cell]:
    if apart is None:
        return [("do not fit on each other", True), *[("\N{EN DASH}", False)] * 2]
    return [(f"{1e3 * each:.1f} mm", False) for each in (apart.median, apart.mean, apart.p95)]


def _draw_tops(runs: Sequence[ComparedRun]) -> str:
    """Return the top views over each other, coloured by run."""
    points = np.concatenate([run.model.points for run in runs])
    index = np.repeat(np.arange(len(runs)), [len(run.model) for run in runs])
    return draw_top_view(
        points, index, [],
        sweep_width=0.0, standoff=0.0,
        title="; ".join(f"{k}: {run.name}" for k, run in enumerate(runs)),
    )  # fmt: skip


def _render_coverage(runs: Sequence[ComparedRun]) -> str:
    """Return coverage against time, a line a run; of the outline where no truth is known."""
    known = all(run.report.get("coverage_by_view") for run in runs)
    series, end = [], 0.0
    for k, run in enumerate(runs):
        times = [float(view.observation.image.stamps.max()) for view in run.session.views]
        shares = run.report["coverage_by_view"] if known else _scanned(run)
        end = max(end, *times)
        dots = [
            Dot(time, share, view_colour(k), title=f"{run.name}, view {j}: {share:.1%}")
            for j, (time, share) in enumerate(zip(times, shares, strict=False))
        ]
        series.append(Series(dots, view_colour(k)))
    chart = Chart(
        "Coverage against time", "time on the robot's clock [s]", "covered" if known else "scanned",
        (0.0, end if end > 0.0 else 1.0), (0.0, 1.0), series[0].dots,
        percent="y", width=520, height=260, colour=series[0].colour, others=series[1:],
    )  # fmt: skip
    what = (
        "Share of the surface in reach of the lidar that lies within 20 mm of the model"
        if known
        else "Share of the target's outline in top view, as far as the robot knows it, scanned"
    )
    return (
        f'<h2>Coverage</h2><figure class="wide">{render_chart(chart)}'
        f"<figcaption>{what}, at the end of each view, in the colours of the runs."
        "</figcaption></figure>"
    )


def _scanned(run: ComparedRun) -> list[float]:
    session = run.session
    return [
        measure_scanned_share(replace(session, views=session.views[: k + 1]))
        for k in range(len(session.views))
    ]


def _named(k: int, run: ComparedRun) -> Cell:
    return (
        f'<span class="swatch" style="background:{view_colour(k)}"></span>{escape(run.name)}',
        False,
    )


def _cell(value: Any, form: str) -> Cell:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return (form.format(value) if known else "\N{EN DASH}", False)
