"""Range noise, its correlation and yaw jitter of a sweep, from its own readings, in NumPy.

At one beam the inverse range q of a plane is linear in the yaw but for terms of second order, so
that its sixth difference D across seven lines is noise, of variance 924 s^2 / r^4. Of uneven lines
D is what the sixth difference leaves without the first five powers of the yaw.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

SIXTH = np.array([-1.0, 6.0, -15.0, 20.0, -15.0, 6.0, -1.0])
SQUARES = 924.0
"""Sum of the squares of ``SIXTH``."""
POWERS = 5
"""Powers of the yaw, from 0 on, that a difference leaves out."""
REACH, SLOPE_REACH = 3, 2
"""Lines to each side that a sixth difference and a slope take."""
BEAM_REACH = 4
"""Beams to each side, where lines have elevations of their own."""
MIN_READINGS = 200
"""Least number of differences for an estimate."""
MOST_READINGS = 1200
"""More are thinned out: the estimate is good to 4 % then."""
BINS = 256
"""Bins of the histogram that finds the quartiles of the ranges."""
LEAST_SPREAD = 2.5e-4
"""Variance of the quarters' mean ranges [m2] from which on the noise may grow with them."""
MAD = 1.4826
"""Standard deviation per median absolute deviation of a normal distribution."""
LEAST_SIGMA = 0.0005
"""Readings are never believed to be better than this [m]: half of the usual 1 mm resolution."""
USUAL = 0.004, 0.0009
"""Range sigma at 0 [m] and its growth per metre of a URG-04LX, where nothing else is known."""
BOUND = 3.0
"""Of a difference, in standard deviations: beyond is an edge."""
MOST_JUMP = 5.66
"""From line to line, beside the slope, in sigmas of a reading: beyond is an edge."""
LAGS, FAR_LAG = 6, 10
"""Beams within which noise is correlated, and beams apart at which it is not."""
MOST_CORRELATION = 8.0
MIN_SLOPE = 0.1
"""Of the range over the yaw, for the jitter [m/rad]."""
MOST_INCIDENCE = 1.73
"""Tangent of the incidence (60 deg) up to which readings take part."""
MIN_LINES = 10
"""Least number of lines for an estimate of the jitter."""
LIKELY_JITTER = np.radians(0.1)
"""Yaw jitter before the sweep is seen: root of its mean square [rad]."""
LEAST_CLEAR = 0.2
"""Least share of a line's squared slopes that is not their noise."""
OUTLIER, LEFT, SPREAD = 2.0, 0.742, 0.964
"""Cap of a squared turn, in expected ones; the share of the mean square it leaves, and the variance
of a capped square by the square of its mean."""
ROUNDS = 8
INDEPENDENT = 400.0
"""Of 924 lines, as many count as independent: their differences overlap (assumption)."""
TRUNCATED = 2.5465
"""8 / pi, for the mean of a normal distribution cut off at 0: exact for one about 0, .64 times the
mean where 0 is many deviations above its middle."""


def estimate_noise(
    ranges: FloatArray, yaws: FloatArray, valid: BoolArray, rays: FloatArray | None = None
) -> FloatArray:
    """Return range sigma at 0, its growth, sigma of a line's yaw, factor for correlation (4,).

    Args:
        ranges: (n_lines, n_beams) [m].
        yaws: (n_lines, n_beams) [rad].
        valid: Readings that are distances (n_lines, n_beams).
        rays: Directions in ``base`` of lines with elevations of their own (n_lines, n_beams, 3).
    """
    D, slope = differences(ranges, yaws, valid, rays)
    middle = yaws[:, yaws.shape[1] // 2]
    at_zero, growth = range_noise(ranges, valid, D)
    sigma = at_zero + growth * ranges
    D = without_jumps(D, slope, ranges, sigma, valid, yaws, rays is not None)
    c = correlation(D, sigma)
    return np.array([at_zero, growth, yaw_jitter(D, slope, sigma, c, ranges, middle), c])


def differences(
    ranges: FloatArray, yaws: FloatArray, valid: BoolArray, rays: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return r^2 times the sixth difference of 1 / r, and the slope of r over the yaw.

    Both (n_lines, n_beams), NaN where one of the seven readings is missing or the line has not
    turned.
    """
    D, slope = np.full(ranges.shape, np.nan), np.full(ranges.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = np.where(valid, 1.0 / ranges, np.nan)
    middle = yaws[:, yaws.shape[1] // 2]
    for i in range(REACH, len(ranges) - REACH):
        lines = slice(i - REACH, i + REACH + 1)
        if middle[i + SLOPE_REACH] == middle[i - SLOPE_REACH]:
            continue
        weights, per_yaw = stencil(middle[lines])
        whole = valid[lines].all(axis=0)
        square = ranges[i, whole] ** 2
        slope[i, whole] = square * (per_yaw @ q[lines][:, whole])
        D[i, whole] = square * (weights @ q[lines][:, whole])
        if rays is not None:
            D[i] -= ranges[i] ** 2 * _by_elevation(q[i], rays[lines], weights)
    return D, slope


def stencil(yaws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights of seven lines (7,): of a difference, and of a slope independent of it."""
    turn = yaws[REACH + SLOPE_REACH] - yaws[REACH - SLOPE_REACH]
    powers = np.vander((yaws - yaws[REACH]) / turn, POWERS, increasing=True)
    weights = SIXTH - powers @ np.linalg.lstsq(powers, SIXTH, rcond=None)[0]
    weights *= math.sqrt(SQUARES / (weights @ weights))
    per_yaw = np.zeros(len(yaws))
    per_yaw[[REACH - SLOPE_REACH, REACH + SLOPE_REACH]] = -1.0 / turn, 1.0 / turn
    return weights, per_yaw - (weights @ per_yaw) / SQUARES * weights


def _by_elevation(q: FloatArray, rays: FloatArray, weights: FloatArray) -> FloatArray:
    """Return what the difference (n_beams,) owes to the elevations of seven lines' rays."""
    owed = np.full(len(q), np.nan)
    here, inner = rays[REACH], slice(BEAM_REACH, -BEAM_REACH)
    along = here[2 * BEAM_REACH :] - here[: -2 * BEAM_REACH]
    off = np.einsum("k,kjm->jm", weights, rays - here)[inner]
    rise = q[2 * BEAM_REACH :] - q[: -2 * BEAM_REACH]
    owed[inner] = rise * np.sum(off * along, axis=1) / np.sum(along**2, axis=1)
    return owed


def range_noise(ranges: FloatArray, valid: BoolArray, D: FloatArray) -> tuple[float, float]:
    """Return range sigma at 0 and its growth per metre; as usual if the sweep is too small.

    The median of |D| r^2 / sqrt(924) over each quarter of the readings by range, and a straight
    line through the four.
    """
    every = np.flatnonzero(valid[REACH:-REACH])
    if len(every) < MIN_READINGS:
        return USUAL
    some = every[:: max(1, len(every) // MOST_READINGS)]
    some = some[np.isfinite(D[REACH:-REACH].reshape(-1)[some])]
    if len(some) < MIN_READINGS / 2:
        return USUAL
    r = ranges[REACH:-REACH].reshape(-1)[some]
    deviation = np.abs(D[REACH:-REACH].reshape(-1)[some]) * (MAD / math.sqrt(SQUARES))

    # median of each quarter by range
    quarter, share = quarters(r), np.zeros(4)
    x, y = np.zeros(4), np.zeros(4)
    for k in range(4):
        part = np.flatnonzero(quarter == k)
        if len(part) > 0:
            share[k] = len(part) / len(r)
            x[k] = np.sum(r[part]) / len(part)
            y[k] = np.sort(deviation[part])[len(part) // 2]

    # a straight line through the four
    x_mean, y_mean = np.sum(share * x), np.sum(share * y)
    off = share * (x - x_mean)
    spread = np.sum(off * (x - x_mean))
    slope = np.sum(off * y) / spread if spread > LEAST_SPREAD else 0.0
    slope = max(0.0, min(slope, y_mean / x_mean))
    return max(LEAST_SIGMA, y_mean - slope * x_mean), slope


def quarters(values: FloatArray) -> IntArray:
    """Return to which quarter of ``values`` by size each belongs (n,); like values stay together.

    By their places in a histogram: sorting thousands takes longer than all the rest.
    """
    low, high = np.min(values), np.max(values)
    bins = ((values - low) * (BINS / (high - low + 1e-9))).astype(np.int64)
    up_to = np.cumsum(np.bincount(bins, minlength=BINS + 1))
    result: IntArray = ((up_to - 1) * 4 // len(values))[bins]
    return result


def without_jumps(
    D: FloatArray,
    slope: FloatArray,
    ranges: FloatArray,
    sigma: FloatArray,
    valid: BoolArray,
    yaws: FloatArray,
    own_elevations: bool,
) -> FloatArray:
    """Return ``D`` (n_lines, n_beams) without what lies across the end of a surface.

    Where lines have their own elevations, what a beam's height changes is no jump.
    """
    kept = D.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        q = np.where(valid, 1.0 / ranges, np.nan)
    turns = np.diff(yaws[:, yaws.shape[1] // 2])[:, None]
    limit = MOST_JUMP * (sigma + LIKELY_JITTER * np.abs(slope))
    if own_elevations:
        limit[:, BEAM_REACH:-BEAM_REACH] += np.abs(
            ranges[:, 2 * BEAM_REACH :] - ranges[:, : -2 * BEAM_REACH]
        ) / (2 * BEAM_REACH)
    for i in range(REACH, len(D) - REACH):
        steps = slice(i - REACH, i + REACH)
        straight = slope[i] / ranges[i] ** 2 * turns[steps]
        jumps = np.abs(np.diff(q[i - REACH : i + REACH + 1], axis=0) - straight)
        with np.errstate(invalid="ignore"):
            kept[i, np.max(jumps, axis=0) * ranges[i] ** 2 > limit[i]] = np.nan
    return kept


def correlation(D: FloatArray, sigma: FloatArray) -> float:
    """Return 1 + 2 sum rho_k: the factor on the variance of a mean along a line.

    What beams ``FAR_LAG`` apart have in common is the yaw error of their lines.
    """
    step = max(1, D.size // (16 * MOST_READINGS))
    z = (D / (math.sqrt(SQUARES) * sigma))[REACH:-REACH:step]
    z = np.where(np.abs(z) <= BOUND, z, np.nan)
    n = z.shape[1]
    products = [z[:, : n - lag] * z[:, lag:] for lag in range(min(n, FAR_LAG + 1))]
    if n <= FAR_LAG or np.count_nonzero(np.isfinite(products[FAR_LAG])) < MIN_READINGS:
        return 1.0
    means = np.array([np.nanmean(product) for product in products])
    own = means - means[FAR_LAG]
    factor = 1.0 + 2.0 * np.sum(own[1:LAGS]) / own[0]
    return float(min(max(factor, 1.0), MOST_CORRELATION))


def yaw_jitter(
    D: FloatArray,
    slope: FloatArray,
    sigma: FloatArray,
    c: float,
    ranges: FloatArray,
    yaws: FloatArray,
) -> float:
    """Return the standard deviation [rad] of the lines' ``yaws`` (n_lines,).

    The regression of a line's D on its slope is the sum of the yaw errors of seven lines, weighted
    as in D and by how alike their slopes are, and noise of variance 924 c k S / S'^2 with S the sum
    of w slope^2 and S' what of it is not noise of the slopes.
    The factor k, at least 1, is what the squares of w slope (D - its regression) exceed
    924 w slope^2 by.
    """
    square, expected, found, assumed = [], [], 0.0, 0.0
    for at in range(2 * REACH, len(D) - 2 * REACH):
        near = slope[at - REACH : at + REACH + 1]
        limit = math.sqrt(SQUARES) * (BOUND * sigma[at] + 3 * LIKELY_JITTER * np.abs(slope[at]))
        with np.errstate(invalid="ignore"):
            good = (np.abs(D[at]) < limit) & (np.abs(slope[at]) > MIN_SLOPE)
            good &= np.abs(slope[at]) <= MOST_INCIDENCE * ranges[at]
        good &= np.isfinite(near).all(axis=0)
        w = 1.0 / sigma[at, good] ** 2
        own = np.sum(w * slope[at, good] ** 2)
        if not own > 0:
            continue
        onto = np.sum(w * slope[at, good] * D[at, good])
        alike = near[:, good] @ (w * slope[at, good]) - len(w) * slope_noise(yaws, at)
        clear = alike[REACH]
        if not clear > LEAST_CLEAR * own:
            continue
        weights, _ = stencil(yaws[at - REACH : at + REACH + 1])
        gain = np.sum((weights * alike / clear) ** 2)
        square.append((onto / clear) ** 2 / gain)
        expected.append(SQUARES * c * own / clear**2 / gain)
        off = D[at, good] - slope[at, good] * onto / own
        found += np.sum((w * slope[at, good] * off) ** 2)
        assumed += SQUARES * own
    larger = max(1.0, found / assumed) if assumed > 0 else 1.0
    return jitter_of(np.array(square), larger * np.array(expected))


def slope_noise(yaws: FloatArray, at: int) -> FloatArray:
    """Return the covariances (7,) of a line's slope with those of the seven, by noise of size 1."""
    per_yaw = np.zeros((2 * REACH + 1, 4 * REACH + 1))
    for k in range(2 * REACH + 1):
        first = at + k - 2 * REACH
        per_yaw[k, k : k + 2 * REACH + 1] = stencil(yaws[first : first + 2 * REACH + 1])[1]
    result: FloatArray = per_yaw @ per_yaw[REACH]
    return result


def jitter_of(square: FloatArray, expected: FloatArray) -> float:
    """Return the root of what ``square`` (n,) exceeds ``expected`` (n,) by; 0 for few lines.

    The mean of the posterior: a normal distribution times an exponential one from 0 on, which has
    the mean ``LIKELY_JITTER`` squared.
    """
    if len(square) < MIN_LINES:
        return 0.0
    jitter = LIKELY_JITTER**2
    for _ in range(ROUNDS):
        likely = expected + jitter
        weights = 1.0 / likely**2
        excess = np.sum(weights * (np.minimum(square, OUTLIER * likely) / LEFT - expected))
        excess /= np.sum(weights)
        variance = SQUARES / INDEPENDENT * SPREAD * np.sum((weights * likely) ** 2)
        variance /= np.sum(weights) ** 2
        likeliest = excess - variance / LIKELY_JITTER**2
        jitter = (likeliest + math.sqrt(likeliest * likeliest + TRUNCATED * variance)) / 2
    return math.sqrt(jitter)
