"""The measures of an experiment: name, unit, meaning, and how they follow from records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from scan3d_twin.bench.record import Record
from scan3d_twin.bench.reporting.statistics import (
    Estimate,
    estimate_clustered_rate,
    estimate_median,
    estimate_rate,
)


@dataclass(frozen=True)
class Measure:
    """A measure over several runs.

    Attributes:
        name: Name with its unit, for programs.
        title: Title for readers.
        form: Format of a value.
        of: Computes it from the runs of one scene and variant.
        meaning: Its meaning in a sentence.
    """

    name: str
    title: str
    form: str
    of: Callable[[Sequence[Record]], Estimate]
    meaning: str


@dataclass(frozen=True)
class SummaryRow:
    """The measures of one scene and variant.

    Attributes:
        scene, variant, scope: The group of runs.
        runs: Number of runs, including failed and lost ones.
        failed: Number of runs that an error of the scan ended.
        lost: Number of runs whose worker was lost; they enter no measure.
        figures: Estimates by the name of the measure.
    """

    scene: str
    variant: str
    scope: str
    runs: int
    failed: int
    lost: int
    figures: dict[str, Estimate]


def summarise(records: Iterable[Record]) -> list[SummaryRow]:
    """Return one row per scene and variant."""
    return [_row(list(group)) for _, group in groupby(sorted(records, key=_place), key=_group)]


def _place(record: Record) -> tuple[str, str, int]:
    return record.scene, record.variant, record.seed


def _group(record: Record) -> tuple[str, str]:
    return record.scene, record.variant


def _row(records: list[Record]) -> SummaryRow:
    known = [record for record in records if record.status != "lost"]
    return SummaryRow(
        scene=records[0].scene,
        variant=records[0].variant,
        scope=records[0].scope,
        runs=len(records),
        failed=sum(record.status == "failed" for record in records),
        lost=len(records) - len(known),
        figures={measure.name: measure.of(known) for measure in MEASURES},
    )


def _share(wanted: Callable[[Record], bool]) -> Callable[[Sequence[Record]], Estimate]:
    return lambda records: estimate_rate(sum(map(wanted, records)), len(records))


def _median(value: Callable[[Record], float | None]) -> Callable[[Sequence[Record]], Estimate]:
    def of(records: Sequence[Record]) -> Estimate:
        values = [value(record) for record in records]
        return estimate_median([math.nan if each is None else each for each in values])

    return of


def exceeds_epsilon(record: Record) -> list[bool]:
    """Return for each registered view whether its error exceeds epsilon."""
    errors = [step.error for step in record.steps if step.error is not None]
    return [error > record.epsilon for error in errors]


def error_ratios(record: Record) -> list[float]:
    """Return realised over predicted error of each view that has both."""
    return [
        step.error / step.predicted
        for step in record.steps
        if step.error is not None and step.predicted
    ]


def _calibration(records: Sequence[Record]) -> Estimate:
    medians = [
        estimate_median(error_ratios(record)).value for record in records if error_ratios(record)
    ]
    return estimate_median(medians)


def _mm(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _plan_per_view(record: Record) -> float | None:
    times = [1e3 * step.plan_cpu for step in record.steps if step.plan_cpu is not None]
    return float(np.median(times)) if times else None


MEASURES: tuple[Measure, ...] = (
    Measure(
        "success",
        "success",
        "{:.0%}",
        _share(lambda r: r.success),
        "Runs with at least two views in which every registration error is at most epsilon.",
    ),
    Measure(
        "complete",
        "complete",
        "{:.0%}",
        _share(lambda r: r.complete),
        "Runs that ended because nothing was left to scan.",
    ),
    Measure("views", "views", "{:.1f}", _median(lambda r: r.views), "Views of a run."),
    Measure(
        "max_error_mm",
        "worst error [mm]",
        "{:.1f}",
        _median(lambda r: _mm(r.max_error)),
        "The largest registration error of a run.",
    ),
    Measure(
        "violations",
        "above \N{GREEK SMALL LETTER EPSILON}",
        "{:.1%}",
        lambda records: estimate_clustered_rate([exceeds_epsilon(record) for record in records]),
        "Registrations with an error above epsilon; the interval draws whole runs.",
    ),
    Measure(
        "calibration",
        "real/predicted",
        "{:.2f}",
        _calibration,
        "Realised over predicted error: the median of the runs' medians.",
    ),
    Measure(
        "coverage",
        "coverage",
        "{:.1%}",
        _median(lambda r: r.coverage),
        "Share of the coverable surface within 20 mm of the model.",
    ),
    Measure("f20", "F@20", "{:.3f}", _median(lambda r: r.f20), "F-score at 20 mm."),
    Measure(
        "path_m", "path [m]", "{:.1f}", _median(lambda r: r.path), "Way of the robot, by odometry."
    ),
    Measure(
        "sim_time_s",
        "time [s]",
        "{:.0f}",
        _median(lambda r: r.duration),
        "On the robot's clock, without the planner's thinking.",
    ),
    Measure(
        "plan_ms",
        "plan [ms/view]",
        "{:.0f}",
        _median(_plan_per_view),
        "Processor time of a decision: the median of a run's, and of the runs.",
    ),
)
"""All measures, in the order of the table."""


def format_table(rows: Sequence[SummaryRow]) -> list[list[str]]:
    """Return the table as text cells with a heading: values, and intervals in brackets."""
    heading = ["scene", "variant", "runs", *(measure.title for measure in MEASURES)]
    return [heading, *([*_names(row), *(_cell(row, m) for m in MEASURES)] for row in rows)]


def _names(row: SummaryRow) -> list[str]:
    bad = [f"{n} {word}" for n, word in ((row.failed, "failed"), (row.lost, "lost")) if n]
    return [row.scene, row.variant, f"{row.runs} ({', '.join(bad)})" if bad else str(row.runs)]


def _cell(row: SummaryRow, measure: Measure) -> str:
    return format_estimate(row.figures[measure.name], measure.form)


def format_estimate(estimate: Estimate, form: str) -> str:
    """Return a value with its interval, if any, in brackets; a dash without runs."""
    if estimate.n == 0:
        return "-"
    if not estimate.has_interval:
        return form.format(estimate.value)
    low, high = form.format(estimate.low), form.format(estimate.high)
    return f"{form.format(estimate.value)} [{low}, {high}]"


def rows_as_dicts(rows: Sequence[SummaryRow]) -> list[dict[str, Any]]:
    """Return the rows as dicts: each measure as value, low, high and n."""
    return [
        {
            "scene": row.scene,
            "variant": row.variant,
            "scope": row.scope,
            "runs": row.runs,
            "failed": row.failed,
            "lost": row.lost,
            **{name: _plain(estimate) for name, estimate in row.figures.items()},
        }
        for row in rows
    ]


def _plain(estimate: Estimate) -> dict[str, float | int | None]:
    def known(value: float) -> float | None:
        return round(value, 6) if math.isfinite(value) else None

    return {
        "value": known(estimate.value),
        "low": known(estimate.low),
        "high": known(estimate.high),
        "n": estimate.n,
    }
