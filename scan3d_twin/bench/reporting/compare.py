"""Variants against each other on the same seeds, and against the oracle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from scan3d_twin.bench.record import Record
from scan3d_twin.bench.reporting.statistics import (
    Estimate,
    estimate_median,
    mcnemar_p,
    wilcoxon_p,
)


@dataclass(frozen=True)
class Comparison:
    """A variant against the reference of its scene and scope, paired by seed.

    Attributes:
        scene, scope, variant, reference: The compared runs.
        pairs: Number of seeds that both have.
        success: Success rate minus that of the reference.
        success_p: p value of McNemar's exact test on success.
        views: Ratio of views to the reference, median of the pairs.
        views_p: p value of Wilcoxon's signed-rank test on views.
        time: Ratio of the robot's time to the reference, median of the pairs.
        time_p: p value of Wilcoxon's signed-rank test on time.
    """

    scene: str
    scope: str
    variant: str
    reference: str
    pairs: int
    success: float
    success_p: float
    views: Estimate
    views_p: float
    time: Estimate
    time_p: float


@dataclass(frozen=True)
class Regret:
    """A variant against the oracle of its scene, on equal seeds and at equal coverage.

    Attributes:
        scene, variant, oracle: The compared runs.
        regret: Ratio of views to the oracle, both up to the lower of the two final coverages.
    """

    scene: str
    variant: str
    oracle: str
    regret: Estimate


Runs = dict[str, dict[int, Record]]
"""Records by variant and seed."""


def compare_variants(records: Iterable[Record]) -> list[Comparison]:
    """Return each variant against the best variant of its scene and scope.

    Scopes are not mixed: to register whole sweeps is an easier task than to register the target
    alone. The best variant has the highest success rate and, among equals, the fewest views;
    oracles know the truth and are no reference.
    """
    found = []
    for (scene, scope), runs in _group_runs(records, lambda r: (r.scene, r.scope)).items():
        able = [name for name in runs if not _is_oracle(runs[name])]
        if len(runs) < 2 or not able:
            continue
        reference = min(able, key=lambda name: (*_rank(list(runs[name].values())), name))
        for name in runs:
            if name != reference:
                found.append(_compare(scene, scope, name, runs[name], reference, runs))
    return found


def compare_with_oracle(records: Iterable[Record]) -> list[Regret]:
    """Return each variant against each oracle of its scene."""
    found = []
    for (scene, _), runs in _group_runs(records, lambda r: (r.scene, "")).items():
        oracles = [name for name in runs if _is_oracle(runs[name])]
        for oracle in oracles:
            for name in runs:
                if name not in oracles:
                    ratios = [_regret(a, b) for a, b in _pairs(runs[name], runs[oracle])]
                    found.append(Regret(scene, name, oracle, estimate_median(ratios)))
    return found


def views_to(record: Record, coverage: float) -> int | None:
    """Return the number of views up to ``coverage``; None if it was never reached."""
    reached = [step.view + 1 for step in record.steps if (step.coverage or 0.0) >= coverage]
    return min(reached, default=None)


def _group_runs(
    records: Iterable[Record], key: Callable[[Record], tuple[str, str]]
) -> dict[tuple[str, str], Runs]:
    found: dict[tuple[str, str], Runs] = {}
    for record in records:
        if record.status != "lost":
            group = found.setdefault(key(record), {})
            group.setdefault(record.variant, {})[record.seed] = record
    return found


def _is_oracle(runs: dict[int, Record]) -> bool:
    return any(record.planner == "oracle" for record in runs.values())


def _rank(records: Sequence[Record]) -> tuple[float, float]:
    success = sum(record.success for record in records) / len(records)
    return -success, estimate_median([record.views for record in records]).value


def _pairs(a: dict[int, Record], b: dict[int, Record]) -> list[tuple[Record, Record]]:
    return [(a[seed], b[seed]) for seed in sorted(a.keys() & b.keys())]


def _compare(
    scene: str, scope: str, name: str, mine: dict[int, Record], reference: str, runs: Runs
) -> Comparison:
    # Pair the runs by seed
    pairs = _pairs(mine, runs[reference])
    a, b = [x for x, _ in pairs], [y for _, y in pairs]
    timed = [(x.duration, y.duration) for x, y in pairs if x.duration and y.duration]
    count = max(1, len(pairs))

    # Estimate ratios, test the differences
    return Comparison(
        scene=scene,
        scope=scope,
        variant=name,
        reference=reference,
        pairs=len(pairs),
        success=(sum(x.success for x in a) - sum(y.success for y in b)) / count,
        success_p=mcnemar_p([x.success for x in a], [y.success for y in b]),
        views=estimate_median([x.views / y.views for x, y in pairs if y.views]),
        views_p=wilcoxon_p([x.views for x in a], [y.views for y in b]),
        time=estimate_median([x / y for x, y in timed]),
        time_p=wilcoxon_p([x for x, _ in timed], [y for _, y in timed]),
    )


def _regret(record: Record, oracle: Record) -> float:
    """Return the ratio of views up to the lower final coverage; NaN if one covered nothing."""
    coverage = min(record.coverage, oracle.coverage)
    mine, least = views_to(record, coverage), views_to(oracle, coverage)
    if coverage <= 0 or mine is None or least is None:
        return math.nan
    return mine / least
