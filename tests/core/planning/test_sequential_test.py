"""When a test by draws may stop early, against the test with all draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import betabinom

from scan3d_twin.core.planning.prediction.sequential_test import (
    _probability_at_most,
    count_allowed_failures,
    is_decided,
)


@given(st.integers(1, 40), st.floats(0.05, 1.0))
def test_the_allowance_is_that_of_the_order_statistic(draws: int, quantile: float) -> None:
    allowed = count_allowed_failures(draws, quantile)
    for failures in range(draws + 1):
        errors = [0.0] * (draws - failures) + [1.0] * failures
        passes = np.quantile(errors, quantile, method="higher") <= 0.5
        assert passes == (failures <= allowed)


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.floats(0.1, 1.0))
def test_full_certainty_never_changes_the_outcome(fails: list[bool], quantile: float) -> None:
    allowed = count_allowed_failures(len(fails), quantile)
    for drawn in range(1, len(fails) + 1):
        failures = sum(fails[:drawn])
        if is_decided(failures, drawn, len(fails), quantile, 1.0):
            assert (failures <= allowed) == (sum(fails) <= allowed)
            return
    pytest.fail("a test with all its draws is decided")


@pytest.mark.parametrize(("share", "most"), [(0.02, 0.8), (0.1, 0.7), (0.5, 0.2)])
def test_less_certainty_saves_draws_and_seldom_changes_the_outcome(
    share: float, most: float
) -> None:
    rng, used, same, runs = np.random.default_rng(0), 0, 0, 200
    for _ in range(runs):
        fails = rng.random(20) < share
        drawn = next(k for k in range(1, 21) if is_decided(int(fails[:k].sum()), k, 20, 0.9, 0.95))
        early = fails[:drawn].sum() <= count_allowed_failures(drawn, 0.9)
        used, same = (
            used + drawn,
            same + (early == (fails.sum() <= count_allowed_failures(20, 0.9))),
        )
    assert used < most * 20 * runs
    assert same > 0.85 * runs


@given(st.integers(0, 30), st.integers(0, 30), st.floats(0.5, 20.0), st.floats(0.5, 20.0))
def test_the_distribution_is_the_beta_binomial(most: int, more: int, a: float, b: float) -> None:
    n = most + more
    assert _probability_at_most(most, n, a, b) == pytest.approx(
        betabinom.cdf(most, n, a, b), rel=1e-9
    )
