"""The figures of a report that show single steps: the chosen overlaps and the step lengths."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from scipy.stats import spearmanr

from scan3d_twin.bench.record import Record
from scan3d_twin.bench.reporting.figure import Cells, Figure, Group
from scan3d_twin.bench.reporting.plot import Dot, Plot, axis_over, share_axis
from scan3d_twin.bench.reporting.run_list import run_anchor
from scan3d_twin.bench.reporting.statistics import wilcoxon_p


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
    """Return the chosen overlap along the path round the target."""
    # Select variants that choose the overlap
    steps = {v: [(r, s) for r in runs for s in steps_of(r) if s[2] is not None]
             for v, runs in group.items()}  # fmt: skip
    steps = {v: rows for v, rows in steps.items() if len({s[2] for _, s in rows}) > 1}
    if not steps:
        return None

    # Span the axes
    ways = [s[0] for rows in steps.values() for _, s in rows]
    x = axis_over("way along the viewpoints [m]", ways)
    plot = Plot(
        f"{scene}: chosen overlap along the target",
        x,
        share_axis("overlap \N{GREEK SMALL LETTER ETA}"),
    )

    # Draw dots and running medians
    rows: Cells = [["variant", "way_m", "step_m", "overlap", "feature"]]
    for variant, found in steps.items():
        plot.add_legend(variant, paint[variant])
        points = [(way, eta, run) for run, (way, _, eta, _) in found if eta is not None]
        plot.add_dots(
            [_step_dot(run, way, eta, f"overlap {eta:.0%}") for way, eta, run in points],
            paint[variant],
        )
        plot.add_line(_running_median([(way, eta) for way, eta, _ in points]), paint[variant])
        rows += [[variant, *row] for _, row in found]

    # Return it with its caption
    caption = "One dot a step, and their running median, for planners that choose the overlap."
    return Figure("overlap", f"overlap-{scene}", caption, plot.render(), rows)


def draw_features(scene: str, group: Group, paint: dict[str, str]) -> Figure | None:
    """Return the length of a step against the feature score before it (the paper's claim)."""
    # Select steps with a feature score
    steps = {v: [(r, s) for r in runs for s in steps_of(r) if s[3] is not None]
             for v, runs in group.items()}  # fmt: skip
    steps = {v: rows for v, rows in steps.items() if rows}
    if not steps:
        return None

    # Span the axes
    everything = [s for rows in steps.values() for _, s in rows]
    x = axis_over("feature score before the step", [s[3] or 0.0 for s in everything])
    y = axis_over("length of the step [m]", [0, *(s[1] for s in everything)])
    plot = Plot(f"{scene}: steps and features", x, y)

    # Draw dots, name the rank correlation
    rows: Cells = [["variant", "steps", "spearman", "p", "O3O4_less_O1O2_m", "p"]]
    for variant, found in steps.items():
        plot.add_dots(
            [_step_dot(r, s[3] or 0.0, s[1], f"step of {s[1]:.2f} m") for r, s in found],
            paint[variant],
        )
        claim = _test_claim([s for _, s in found], group[variant])
        rho = f": \N{GREEK SMALL LETTER RHO} {claim[0]:.2f}" if math.isfinite(claim[0]) else ""
        plot.add_legend(f"{variant}{rho}", paint[variant])
        rows.append([variant, len(found), *claim])

    # Return it with its caption
    caption = (
        "The paper says that steps are long where the surface has features: then Spearman's rank "
        "correlation \N{GREEK SMALL LETTER RHO} of length and feature score is positive. Feature "
        "score: the spread of the normals over the half of the view that the robot leaves by."
    )
    return Figure("overlap", f"features-{scene}", caption, plot.render(), rows)


def _step_dot(run: Record, x: float, y: float, words: str) -> Dot:
    """Return the dot of a step at (x, y), which leads to the line of its run."""
    return Dot(x, y, f"{run.variant}, seed {run.seed}: {words}", f"#{run_anchor(run)}")


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


def _running_median(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the medians of up to ten consecutive parts of ``points``, along x."""
    ordered = sorted(points)
    parts = np.array_split(np.array(ordered), min(10, max(1, len(ordered) // 5)))
    return [(float(np.median(part[:, 0])), float(np.median(part[:, 1]))) for part in parts]
