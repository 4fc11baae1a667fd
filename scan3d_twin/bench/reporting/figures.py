"""The figures of a report, each with the numbers it shows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from scan3d_twin.bench.record import Record, Step
from scan3d_twin.bench.reporting.measures import error_ratios
from scan3d_twin.bench.reporting.plot import Axis, Plot, assign_colours, axis_over, share_axis
from scan3d_twin.bench.reporting.statistics import (
    Estimate,
    estimate_median,
    estimate_rate,
    wilcoxon_p,
)

CURVE_POINTS = 40
"""Number of points along an axis at which curves are sampled."""
Cells = list[list[str | float | int | None]]


@dataclass(frozen=True)
class Figure:
    """A figure with its caption and its numbers.

    Attributes:
        name: Name of its files.
        caption: Text below it.
        svg: The picture.
        rows: Its numbers, with a heading.
    """

    name: str
    caption: str
    svg: str
    rows: Cells


Group = dict[str, list[Record]]
"""Runs of one scene by variant."""


def draw_figures(records: Sequence[Record]) -> list[Figure]:
    """Return figures F2 to F7 of all scenes; figures without data are left out."""
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
    return [figure for figure in found if figure is not None]


def draw_pareto(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F2: number of views against the worst registration error, one dot per run."""
    # Select runs with a registration
    shown = [r for runs in group.values() for r in runs if r.max_error]
    if not shown:
        return None

    # Span the axes, mark epsilon
    x = axis_over("views", [0, *(r.views for r in shown)])
    y = axis_over("worst registration error [mm]", [_mm(r.max_error) for r in shown], log=True)
    plot = Plot(f"{scene}: views and worst error", x, y)
    plot.add_limit(1e3 * shown[0].epsilon, "\N{GREEK SMALL LETTER EPSILON}")

    # Draw dots, variants side by side
    rows: Cells = [["variant", "seed", "views", "max_error_mm", "success"]]
    for k, (variant, runs) in enumerate(group.items()):
        plot.add_legend(variant, paint[variant])
        shift = 0.5 * (k + 1) / (len(group) + 1) - 0.25
        plot.add_dots([(r.views + shift, _mm(r.max_error)) for r in runs], paint[variant])
        rows += [[variant, r.seed, r.views, _mm(r.max_error), int(r.success)] for r in runs]

    # Return it with its caption
    caption = "One dot a run; below the dashed line every registration met epsilon."
    return Figure(f"F2-{_in_file_name(scene)}", caption, plot.render(), rows)


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
    """F3: coverage over views, metres or seconds, as medians with their intervals."""
    # Choose places along the axis
    steps = [step for runs in group.values() for run in runs for step in run.steps]
    if not steps:
        return None
    x = axis_over(along.label, [0, *map(along.of, steps)])
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
    return Figure(f"F3-{_in_file_name(scene)}-{along.name}", caption, plot.render(), rows)


def _covered(run: Record, along: CoverageAxis, at: float) -> float:
    """Return the coverage of ``run`` at ``at`` on the axis ``along``."""
    return max((s.coverage or 0.0 for s in run.steps if along.of(s) <= at), default=0.0)


def draw_calibration(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F4: predicted against realised error, one dot per registration."""
    # Select steps with both errors
    shown = [
        (v, r, s) for v, runs in group.items() for r in runs for s in r.steps if _has_both_errors(s)
    ]
    if not shown:
        return None

    # Span the axes, mark epsilon
    errors = [_mm(value) for _, _, s in shown for value in (s.predicted, s.error)]
    x = axis_over("predicted error [mm]", errors, log=True)
    plot = Plot(f"{scene}: predicted and realised error", x, _relabelled(x, "realised error [mm]"))
    plot.add_diagonal()
    plot.add_limit(1e3 * shown[0][1].epsilon, "\N{GREEK SMALL LETTER EPSILON}")

    # Draw dots, name the median ratio
    for variant in group:
        label = estimate_median([q for r in group[variant] for q in error_ratios(r)])
        plot.add_legend(f"{variant}: \N{MULTIPLICATION SIGN} {label.value:.2f}", paint[variant])
        points = [(_mm(s.predicted), _mm(s.error)) for v, _, s in shown if v == variant]
        plot.add_dots(points, paint[variant], size=2.2)

    # Return it with its numbers
    rows: Cells = [["variant", "seed", "view", "predicted_mm", "error_mm"]]
    rows += [[v, r.seed, s.view, _mm(s.predicted), _mm(s.error)] for v, r, s in shown]
    caption = (
        "One dot a registration; on the dashed diagonal the prediction was right, above it the "
        "error was larger. In the legend: the median of realised over predicted."
    )
    return Figure(f"F4-{_in_file_name(scene)}", caption, plot.render(), rows)


def _has_both_errors(step: Step) -> bool:
    return bool(step.predicted) and bool(step.error)


def steps_of(run: Record) -> list[tuple[float, float, float | None, float | None]]:
    """Return position [m], length [m], eta and feature score of each step of ``run``.

    The position is the distance from the first viewpoint along all viewpoints; the feature score is
    that of the surface before the step.
    """
    rows, way = [], 0.0
    for a, b in zip(run.steps, run.steps[1:], strict=False):
        length = math.hypot(b.x - a.x, b.y - a.y)
        rows.append((way, length, b.overlap, a.feature))
        way += length
    return rows


def draw_overlaps(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F5a: the chosen overlap along the path round the target."""
    # Select variants that choose the overlap
    steps = {v: [s for r in runs for s in steps_of(r) if s[2] is not None]
             for v, runs in group.items()}  # fmt: skip
    steps = {v: rows for v, rows in steps.items() if len({eta for _, _, eta, _ in rows}) > 1}
    if not steps:
        return None

    # Span the axes
    x = axis_over("way along the viewpoints [m]", [s[0] for rows in steps.values() for s in rows])
    plot = Plot(
        f"{scene}: chosen overlap along the target",
        x,
        share_axis("overlap \N{GREEK SMALL LETTER ETA}"),
    )

    # Draw dots and running medians
    rows: Cells = [["variant", "way_m", "step_m", "overlap", "feature"]]
    for variant, found in steps.items():
        plot.add_legend(variant, paint[variant])
        plot.add_dots(
            [(way, eta) for way, _, eta, _ in found if eta is not None], paint[variant], 2.2
        )
        plot.add_line(
            _running_median([(w, e) for w, _, e, _ in found if e is not None]), paint[variant]
        )
        rows += [[variant, *row] for row in found]

    # Return it with its caption
    caption = "One dot a step, and their running median, for planners that choose the overlap."
    return Figure(f"F5a-{_in_file_name(scene)}", caption, plot.render(), rows)


def draw_features(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F5b: length of a step against the feature score before it (the paper's claim)."""
    # Select steps with a feature score
    steps = {v: [s for r in runs for s in steps_of(r) if s[3] is not None]
             for v, runs in group.items()}  # fmt: skip
    steps = {v: rows for v, rows in steps.items() if rows}
    if not steps:
        return None

    # Span the axes
    everything = [s for rows in steps.values() for s in rows]
    x = axis_over("feature score before the step", [s[3] or 0.0 for s in everything])
    y = axis_over("length of the step [m]", [0, *(s[1] for s in everything)])
    plot = Plot(f"{scene}: steps and features", x, y)

    # Draw dots, name the rank correlation
    rows: Cells = [["variant", "steps", "spearman", "p", "O3O4_less_O1O2_m", "p"]]
    for variant, found in steps.items():
        plot.add_dots([(s[3] or 0.0, s[1]) for s in found], paint[variant], 2.2)
        claim = _test_claim(found, group[variant])
        plot.add_legend(f"{variant}: \N{GREEK SMALL LETTER RHO} {claim[0]:.2f}", paint[variant])
        rows.append([variant, len(found), *claim])

    # Return it with its caption
    caption = (
        "The paper says that steps are long where the surface has features: then Spearman's rank "
        "correlation \N{GREEK SMALL LETTER RHO} of length and feature score is positive. Feature "
        "score: the spread of the normals over the half of the view that the robot leaves by."
    )
    return Figure(f"F5b-{_in_file_name(scene)}", caption, plot.render(), rows)


def _test_claim(
    found: list[tuple[float, float, float | None, float | None]], runs: list[Record]
) -> tuple[float, float, float, float]:
    """Return Spearman's rho and its p, the mean of O3-O4 minus O1-O2 [m], and its p."""
    # Correlate length and feature score
    lengths, scores = [s[1] for s in found], [s[3] or 0.0 for s in found]
    constant = len(set(lengths)) < 2 or len(set(scores)) < 2 or len(found) < 3
    rho, p = (math.nan, math.nan) if constant else spearmanr(lengths, scores)

    # Compare the third and first step
    long = [steps_of(run) for run in runs if run.views >= 4]
    third, first = [rows[2][1] for rows in long], [rows[0][1] for rows in long]
    longer = float(np.mean(np.subtract(third, first))) if long else math.nan
    return float(rho), float(p), longer, wilcoxon_p(third, first)


def draw_success_by_lambda(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F6: success rate over the assumed translation error, where runs differ in it."""
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
    return Figure(f"F6-{_in_file_name(scene)}", caption, plot.render(), rows)


def draw_success_bars(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """F7: success rate of all variants side by side."""
    if len(group) < 2:
        return None
    x = Axis("", 0.0, float(len(group)))
    plot = Plot(f"{scene}: success of the variants", x, share_axis("every error within epsilon"))
    rows: Cells = [["variant", "success", "low", "high", "runs"]]
    for k, (variant, runs) in enumerate(group.items()):
        estimate = estimate_rate(sum(r.success for r in runs), len(runs))
        plot.add_legend(f"{variant} ({len(runs)})", paint[variant])
        plot.add_bar(k + 0.5, 0.35, estimate, paint[variant])
        rows.append([variant, *_cells(estimate)])
    caption = "Share of successful runs with its 95 % interval; in brackets the number of runs."
    return Figure(f"F7-{_in_file_name(scene)}", caption, plot.render(), rows)


def _running_median(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the medians of up to ten consecutive parts of ``points``, along x."""
    ordered = sorted(points)
    parts = np.array_split(np.array(ordered), min(10, max(1, len(ordered) // 5)))
    return [(float(np.median(part[:, 0])), float(np.median(part[:, 1]))) for part in parts]


def _relabelled(axis: Axis, label: str) -> Axis:
    return Axis(label, axis.low, axis.high, axis.log, axis.form)


def _cells(estimate: Estimate) -> list[str | float | int | None]:
    return [estimate.value, estimate.low, estimate.high, estimate.n]


def _mm(metres: float | None) -> float:
    return math.nan if metres is None else 1e3 * metres


def _in_file_name(scene: str) -> str:
    """Return the name of a ``scene`` as a part of a file's name; results may name any scene."""
    return re.sub(r"[^\w.-]", "_", scene)
