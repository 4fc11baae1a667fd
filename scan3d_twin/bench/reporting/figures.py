"""The figures of a report, each with the numbers it shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.bench.record import Record, Step
from scan3d_twin.bench.reporting.figure import TITLES, Cells, Figure, Group
from scan3d_twin.bench.reporting.measures import error_ratios
from scan3d_twin.bench.reporting.plot import (
    Axis,
    Dot,
    Plot,
    assign_colours,
    axis_over,
    share_axis,
)
from scan3d_twin.bench.reporting.run_list import run_anchor
from scan3d_twin.bench.reporting.statistics import Estimate, estimate_median, estimate_rate
from scan3d_twin.bench.reporting.step_figures import draw_features, draw_overlaps

CURVE_POINTS = 40
"""Number of points along an axis at which curves are sampled."""


def draw_figures(records: Sequence[Record]) -> list[Figure]:
    """Return the figures of all scenes, kind by kind; figures without data are left out."""
    # Select records with a result
    known = [record for record in records if record.status != "lost"]
    paint = assign_colours(sorted({record.variant for record in known}))

    # Draw the figures scene by scene
    found: list[Figure | None] = []
    for scene in sorted({record.scene for record in known}):
        group: Group = {}
        for record in known:
            if record.scene == scene:
                group.setdefault(record.variant, []).append(record)
        found += [draw_pareto(scene, group, paint)]
        found += [draw_coverage(scene, group, paint, along) for along in COVERAGE_AXES]
        found += [draw_calibration(scene, group, paint), draw_overlaps(scene, group, paint)]
        found += [draw_features(scene, group, paint), draw_success_by_lambda(scene, group, paint)]
        found += [draw_success_bars(scene, group, paint)]
    drawn = [figure for figure in found if figure is not None]
    return sorted(drawn, key=lambda figure: list(TITLES).index(figure.kind))


def draw_pareto(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """Return the number of views against the worst registration error, one dot per run."""
    # Select runs with a registration
    shown = [r for runs in group.values() for r in runs if r.max_error]
    if not shown:
        return None

    # Span the axes, mark epsilon
    x = axis_over("views", [0, *(r.views for r in shown)], step=1.0)
    epsilon = 1e3 * shown[0].epsilon
    errors = [epsilon, *(_mm(r.max_error) for r in shown)]
    y = axis_over("worst registration error [mm]", errors, log=True)
    plot = Plot(f"{scene}: views and worst error", x, y)
    plot.add_limit(epsilon, "\N{GREEK SMALL LETTER EPSILON}")

    # Draw dots, variants side by side
    rows: Cells = [["variant", "seed", "views", "max_error_mm", "success"]]
    for k, (variant, runs) in enumerate(group.items()):
        plot.add_legend(variant, paint[variant])
        shift = 0.5 * (k + 1) / (len(group) + 1) - 0.25
        plot.add_dots([_run_dot(r, shift) for r in runs], paint[variant])
        rows += [[variant, r.seed, r.views, _mm(r.max_error), int(r.success)] for r in runs]

    # Return it with its caption
    caption = "One dot a run; below the dashed line every registration met epsilon."
    return Figure("pareto", f"pareto-{scene}", caption, plot.render(), rows)


def _run_dot(run: Record, shift: float) -> Dot:
    """Return the dot of ``run``, moved sideways by ``shift``, which leads to its line."""
    error = _mm(run.max_error)
    title = f"{run.variant}, seed {run.seed}: {run.views} views, {error:.1f} mm"
    return Dot(run.views + shift, error, title, f"#{run_anchor(run)}")


@dataclass(frozen=True)
class CoverageAxis:
    """An axis over which coverage is plotted: its name, label and value at a step."""

    name: str
    label: str
    of: Callable[[Step], float]


COVERAGE_AXES = (
    CoverageAxis("views", "views", lambda step: step.view + 1),
    CoverageAxis("metres", "driven [m]", lambda step: step.path),
    CoverageAxis("seconds", "robot's time [s]", lambda step: step.time),
)


def draw_coverage(
    scene: str, group: Group, paint: dict[str, str], along: CoverageAxis
) -> Figure | None:
    """Return coverage over views, metres or seconds, as medians with their intervals."""
    # Choose places along the axis
    steps = [step for runs in group.values() for run in runs for step in run.steps]
    if not steps:
        return None
    whole = 1.0 if along.name == "views" else 0.0
    x = axis_over(along.label, [0, *map(along.of, steps)], step=whole)
    if along.name == "views":
        places = [float(k) for k in range(1, int(x.high) + 1)]
    else:
        places = [float(v) for v in np.linspace(0.0, x.high, CURVE_POINTS)]

    # Draw each variant's median curve
    plot = Plot(f"{scene}: coverage", x, share_axis("coverage at 20 mm"))
    rows: Cells = [["variant", along.name, "coverage", "low", "high", "runs"]]
    for variant, runs in group.items():
        plot.add_legend(variant, paint[variant])
        curve = [(at, estimate_median([_covered(r, along, at) for r in runs])) for at in places]
        plot.add_band(curve, paint[variant])
        rows += [[variant, at, *_cells(e)] for at, e in curve]

    # Return it with its caption
    caption = (
        f"Coverage of the coverable surface over {along.name}: median of the runs and its 95 % "
        "interval. A run that has ended keeps what it covered."
    )
    return Figure("coverage", f"coverage-{along.name}-{scene}", caption, plot.render(), rows)


def _covered(run: Record, along: CoverageAxis, at: float) -> float:
    """Return the coverage of ``run`` at ``at`` on the axis ``along``."""
    return max((s.coverage or 0.0 for s in run.steps if along.of(s) <= at), default=0.0)


def draw_calibration(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """Return predicted against realised error, one dot per registration."""
    # Select steps with both errors
    shown = [
        (v, r, s) for v, runs in group.items() for r in runs for s in r.steps if _has_both_errors(s)
    ]
    if not shown:
        return None

    # Span the axes, mark epsilon
    epsilon = 1e3 * shown[0][1].epsilon
    errors = [_mm(value) for _, _, s in shown for value in (s.predicted, s.error)]
    x = axis_over("predicted error [mm]", [epsilon, *errors], log=True)
    plot = Plot(f"{scene}: predicted and realised error", x, _relabelled(x, "realised error [mm]"))
    plot.add_diagonal()
    plot.add_limit(epsilon, "\N{GREEK SMALL LETTER EPSILON}")

    # Draw dots, name the median ratio
    for variant in group:
        label = estimate_median([q for r in group[variant] for q in error_ratios(r)])
        if label.n == 0:
            continue
        plot.add_legend(f"{variant}: \N{MULTIPLICATION SIGN} {label.value:.2f}", paint[variant])
        dots = [_view_dot(r, s) for v, r, s in shown if v == variant]
        plot.add_dots(dots, paint[variant])

    # Return it with its numbers
    rows: Cells = [["variant", "seed", "view", "predicted_mm", "error_mm"]]
    rows += [[v, r.seed, s.view, _mm(s.predicted), _mm(s.error)] for v, r, s in shown]
    caption = (
        "One dot a registration; on the dashed diagonal the prediction was right, above it the "
        "error was larger. In the legend: the median of realised over predicted."
    )
    return Figure("calibration", f"calibration-{scene}", caption, plot.render(), rows)


def _view_dot(run: Record, step: Step) -> Dot:
    """Return the dot of a registration, which leads to the line of its run."""
    predicted, error = _mm(step.predicted), _mm(step.error)
    title = (
        f"{run.variant}, seed {run.seed}, view {step.view}: "
        f"predicted {predicted:.1f} mm, realised {error:.1f} mm"
    )
    return Dot(predicted, error, title, f"#{run_anchor(run)}")


def _has_both_errors(step: Step) -> bool:
    return bool(step.predicted) and bool(step.error)


def draw_success_by_lambda(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """Return the success rate over the assumed translation error, where runs differ in it."""
    # Group records by planner and lambda
    curves: dict[tuple[str, str, str], dict[float, list[Record]]] = {}
    for record in (r for runs in group.values() for r in runs):
        key = record.planner, record.preset, record.scope
        curves.setdefault(key, {}).setdefault(record.lambda_, []).append(record)
    curves = {key: by for key, by in curves.items() if len(by) > 1}
    if not curves:
        return None

    # Span the axes
    x = axis_over(
        "λ of the planner",
        [v for by in curves.values() for v in by],
        log=True,
    )
    plot = Plot(f"{scene}: success and the error the planner assumes", x, share_axis("success"))
    rows: Cells = [["planner", "preset", "scope", "lambda", "success", "low", "high", "runs"]]

    # Draw one curve per planner
    tints = assign_colours(" ".join(key) for key in sorted(curves))
    for key in sorted(curves):
        curve = [(at, estimate_rate(sum(r.success for r in runs), len(runs)))
                 for at, runs in sorted(curves[key].items())]  # fmt: skip
        plot.add_legend(" ".join(key), tints[" ".join(key)])
        plot.add_band(curve, tints[" ".join(key)])
        rows += [[*key, at, *_cells(e)] for at, e in curve]

    # Return it with its caption
    caption = "Runs with every error within epsilon, over the translation error that eq. (2) draws."
    return Figure("lambda", f"lambda-{scene}", caption, plot.render(), rows)


def draw_success_bars(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """Return the success rate of all variants side by side."""
    if len(group) < 2:
        return None
    x = Axis("variant, as numbered below", 0.5, len(group) + 0.5, form="{:.0f}", step=1.0)
    plot = Plot(f"{scene}: success of the variants", x, share_axis("every error within epsilon"))
    rows: Cells = [["variant", "success", "low", "high", "runs"]]
    for k, (variant, runs) in enumerate(group.items(), start=1):
        estimate = estimate_rate(sum(r.success for r in runs), len(runs))
        plot.add_legend(f"{k}: {variant} ({len(runs)})", paint[variant])
        plot.add_bar(k, 0.35, estimate, paint[variant])
        rows.append([variant, *_cells(estimate)])
    caption = "Share of successful runs with its 95 % interval; in brackets the number of runs."
    return Figure("success", f"success-{scene}", caption, plot.render(), rows)


def _relabelled(axis: Axis, label: str) -> Axis:
    return replace(axis, label=label)


def _cells(estimate: Estimate) -> list[str | float | int | None]:
    return [estimate.value, estimate.low, estimate.high, estimate.n]


def _mm(metres: float | None) -> float:
    return math.nan if metres is None else 1e3 * metres
