import math

import numpy as np
import pytest
from scipy.stats import binomtest

from scan3d_twin.bench.reporting.measures import format_estimate
from scan3d_twin.bench.reporting.statistics import (
    NO_ESTIMATE,
    estimate_clustered_rate,
    estimate_median,
    estimate_rate,
    mcnemar_p,
    wilcoxon_p,
)


@pytest.mark.parametrize(("k", "n"), [(0, 10), (5, 10), (95, 100), (100, 100)])
def test_the_interval_of_a_rate_is_wilsons(k, n):
    found = estimate_rate(k, n)
    wilson = binomtest(k, n).proportion_ci(method="wilson")
    assert found.value == k / n
    assert (found.low, found.high) == pytest.approx((wilson.low, wilson.high), abs=1e-6)


def test_medians_come_with_intervals_that_cover():
    """Of many samples with a known median about 95 % must have it within."""
    rng = np.random.default_rng(1)
    within = 0
    for _ in range(200):
        found = estimate_median(list(rng.exponential(size=30)))
        within += found.low <= math.log(2) <= found.high
    assert 175 <= within <= 198


def test_what_is_not_known_is_left_out_and_the_rest_is_the_same_each_time():
    assert (
        estimate_median([])
        == estimate_median([math.nan])
        == estimate_rate(0, 0)
        == estimate_clustered_rate([[]])
        == NO_ESTIMATE
    )
    assert estimate_median([1.0, math.nan, 3.0, 2.0]).n == 3
    assert estimate_median([1.0, 2.0, 3.0]) == estimate_median([1.0, 2.0, 3.0])


def test_a_single_run_has_no_interval():
    """Its bootstrap samples are all the same, which says nothing of other runs."""
    one, group = estimate_median([2.3]), estimate_clustered_rate([[True, False]])
    assert (one.value, one.n, one.has_interval) == (2.3, 1, False)
    assert (group.value, group.n, group.has_interval) == (0.5, 2, False)
    assert estimate_median([2.3, 2.3]).has_interval
    assert estimate_rate(1, 1).has_interval
    assert format_estimate(one, "{:.1f}") == "2.3"


def test_steps_of_one_run_do_not_narrow_an_interval():
    runs = [[k % 2 == 0] for k in range(20)]
    steps = [[k % 2 == 0] * 10 for k in range(20)]
    one, ten = estimate_clustered_rate(runs), estimate_clustered_rate(steps)
    assert one.value == ten.value == 0.5
    assert (ten.low, ten.high) == pytest.approx((one.low, one.high))


def test_paired_tests_tell_a_difference_from_none():
    rng = np.random.default_rng(2)
    a = rng.normal(size=40)
    assert wilcoxon_p(a, a) == 1.0
    assert wilcoxon_p(a + 0.5 + 0.1 * rng.normal(size=40), a) < 1e-6
    assert wilcoxon_p(a + rng.normal(size=40), a) > 0.01
    assert mcnemar_p([True] * 12 + [False] * 8, [False] * 20) == pytest.approx(2 * 0.5**12)
    assert mcnemar_p([True, False], [False, True]) == mcnemar_p([True], [True]) == 1.0
