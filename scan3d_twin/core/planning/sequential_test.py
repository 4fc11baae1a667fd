"""When enough draws are enough: a sequential stop for a test by order statistics.

Of M draws at most ``allowed`` may fail. After k of them, f of which failed, the share of failures
has the posterior Beta(1/2 + f, 1/2 + k - f) (Jeffreys' prior), and the number of failures to come
is beta-binomial. The test ends when it is as likely as ``certainty`` that the remaining draws would
not change its outcome: a predictive probability design (Lee and Liu, Clinical Trials 5, 2008).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import betaln


def allowed_failures(draws: int, quantile: float) -> int:
    """Return how many of ``draws`` may fail while their ``quantile``, rounded up, does not."""
    return draws - 1 - math.ceil(quantile * (draws - 1) - 1e-9)


def decided(failures: int, drawn: int, draws: int, quantile: float, certainty: float) -> bool:
    """Tell whether a test of ``draws`` draws is as good as decided after ``drawn`` of them.

    Args:
        failures: How many of those drawn failed.
        drawn: Draws so far.
        draws: Draws at most.
        quantile: Share of the draws that must not fail.
        certainty: Wanted probability that more draws would not change the outcome; 1 ends the test
            only when they cannot.
    """
    left, allowed = draws - drawn, allowed_failures(draws, quantile)
    if left == 0 or failures > allowed or failures + left <= allowed:
        return True
    if certainty >= 1.0:
        return False
    good = _at_most(allowed - failures, left, 0.5 + failures, 0.5 + drawn - failures)
    return max(good, 1.0 - good) >= certainty


def _at_most(most: int, n: int, a: float, b: float) -> float:
    """Return the probability of at most ``most`` of ``n`` failures of a beta-binomial distribution.

    Written out: ``scipy.stats`` would take more memory than a small computer has left.
    """
    k = np.arange(most + 1)
    ways = -np.log(n + 1.0) - betaln(n - k + 1.0, k + 1.0)
    return float(np.sum(np.exp(ways + betaln(k + a, n - k + b) - betaln(a, b))))
