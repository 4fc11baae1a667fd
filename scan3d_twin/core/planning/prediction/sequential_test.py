"""Early stopping of sampling: a sequential test of how many of M draws fail.

The test passes if at most ``allowed`` of the M draws fail. After k draws, f of which failed, the
share of failures has the posterior Beta(1/2 + f, 1/2 + k - f) (Jeffreys' prior), and the number of
failures to come is beta-binomial. Sampling stops when the remaining draws would not change the
outcome with a probability of ``certainty``: a predictive probability design (Lee and Liu, Clinical
Trials 5, 2008).
"""

from __future__ import annotations

import math


def count_allowed_failures(draws: int, quantile: float) -> int:
    """Return how many of ``draws`` may fail while their ``quantile``, rounded up, passes."""
    return draws - 1 - math.ceil(quantile * (draws - 1) - 1e-9)


def is_decided(failures: int, drawn: int, draws: int, quantile: float, certainty: float) -> bool:
    """Return whether sampling can stop after ``drawn`` of ``draws`` draws.

    Args:
        failures: Number of draws that failed.
        drawn: Number of draws made.
        draws: Number of draws of the whole test.
        quantile: Share of the draws that must not fail.
        certainty: Probability that more draws would not change the outcome at which sampling
            stops; with 1 it stops only when they cannot change it.
    """
    left, allowed = draws - drawn, count_allowed_failures(draws, quantile)
    if left == 0 or failures > allowed or failures + left <= allowed:
        return True
    if certainty >= 1.0:
        return False
    good = _probability_at_most(allowed - failures, left, 0.5 + failures, 0.5 + drawn - failures)
    return max(good, 1.0 - good) >= certainty


def _probability_at_most(most: int, n: int, a: float, b: float) -> float:
    """Return the probability of at most ``most`` of ``n`` failures of a beta-binomial distribution.

    Written out, as SciPy takes more memory than a small computer has.
    """
    ways = (-math.log(n + 1.0) - _log_beta(n - k + 1.0, k + 1.0) for k in range(most + 1))
    shares = (_log_beta(k + a, n - k + b) - _log_beta(a, b) for k in range(most + 1))
    return math.fsum(math.exp(way + share) for way, share in zip(ways, shares, strict=True))


def _log_beta(a: float, b: float) -> float:
    """Return the logarithm of the beta function."""
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
