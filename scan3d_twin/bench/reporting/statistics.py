"""Rates, medians and paired tests; all intervals are 95 % confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, wilcoxon

Z_95 = 1.959964
"""Two-sided 95 % quantile of the standard normal distribution."""
BOOTSTRAP_DRAWS = 2000
"""Bootstrap samples; the ends of an interval then vary by a few percent of its width."""
BOOTSTRAP_SEED = 0
"""Seed of the bootstrap: the same records give the same intervals."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its 95 % interval, from ``n`` values; all NaN without any.

    The interval is NaN where there is none, such as that of the median of a single value.
    """

    value: float
    low: float
    high: float
    n: int

    @property
    def has_interval(self) -> bool:
        """Whether the interval is known."""
        return math.isfinite(self.low) and math.isfinite(self.high)


NO_ESTIMATE = Estimate(math.nan, math.nan, math.nan, 0)


def estimate_rate(successes: int, n: int) -> Estimate:
    """Return a share with its Wilson score interval (Wilson 1927)."""
    if n == 0:
        return NO_ESTIMATE
    p, z = successes / n, Z_95
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return Estimate(p, max(0.0, middle - half), min(1.0, middle + half), n)


def estimate_median(values: Sequence[float]) -> Estimate:
    """Return the median with its percentile bootstrap interval (Efron 1979).

    A single value has no interval: every bootstrap sample of it is that value.
    """
    known = np.asarray([value for value in values if math.isfinite(value)], dtype=np.float64)
    if len(known) == 0:
        return NO_ESTIMATE
    if len(known) == 1:
        return Estimate(float(known[0]), math.nan, math.nan, 1)
    index = np.random.default_rng(BOOTSTRAP_SEED).integers(
        0, len(known), (BOOTSTRAP_DRAWS, len(known))
    )
    draws = np.median(known[index], axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(np.median(known)), float(low), float(high), len(known))


def estimate_clustered_rate(groups: Sequence[Sequence[bool]]) -> Estimate:
    """Return the share of True over all ``groups``, with a cluster bootstrap interval.

    The bootstrap draws whole groups, because the steps of one run share a robot and its errors and
    are not independent. A single group has no interval.
    """
    filled = [group for group in groups if group]
    if not filled:
        return NO_ESTIMATE
    hits = np.array([sum(group) for group in filled])
    sizes = np.array([len(group) for group in filled])
    share, n = float(hits.sum() / sizes.sum()), int(sizes.sum())
    if len(filled) == 1:
        return Estimate(share, math.nan, math.nan, n)
    index = np.random.default_rng(BOOTSTRAP_SEED).integers(
        0, len(filled), (BOOTSTRAP_DRAWS, len(filled))
    )
    draws = hits[index].sum(axis=1) / sizes[index].sum(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(share, float(low), float(high), n)


def wilcoxon_p(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the p value of Wilcoxon's signed-rank test on pairs; 1 if no pair differs."""
    difference = np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64)
    if len(difference) == 0 or not np.any(difference):
        return 1.0
    return float(wilcoxon(difference).pvalue)


def mcnemar_p(a: Sequence[bool], b: Sequence[bool]) -> float:
    """Return the p value of McNemar's exact test on paired successes; 1 if no pair differs."""
    only_a = sum(x and not y for x, y in zip(a, b, strict=True))
    only_b = sum(y and not x for x, y in zip(a, b, strict=True))
    if only_a + only_b == 0:
        return 1.0
    return float(binomtest(only_a, only_a + only_b, 0.5).pvalue)
