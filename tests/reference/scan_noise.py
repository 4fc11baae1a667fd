"""Range noise and yaw jitter of a sweep, estimated from its own readings, in NumPy."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, SmallIntArray

LAG = 2
"""Beams between the three readings of a second difference; next ones may share light."""
MIN_READINGS = 200
"""Least number of second differences for an estimate."""
MOST_READINGS = 1200
"""More are thinned out: the estimate is good to 4 % then."""
BINS = 256
"""Bins of the histogram that finds the quartiles of the ranges."""
LEAST_SPREAD = 2.5e-4
"""Variance of the quarters' mean ranges [m2] from which on the noise may grow with them."""
MAD = 1.4826
"""Standard deviation per median absolute deviation of a normal distribution."""
BIAS_PATCH = np.radians(10.0)
"""Side of a patch of readings that share a range error [rad]: about one face of a thing."""
BIAS_LENGTH = 0.15
"""Way along which a range error changes by itself [m]: 0.26 m for the cycle of 1.6 m of a 46.55 MHz
phase measurement, less at edges and changes of material."""
MIN_LINES = 10
"""Least number of triples of lines for an estimate of the jitter."""
LIKELY_JITTER = np.radians(0.1)
"""Yaw jitter at which the estimate starts [rad]: about that of a Create's wheels."""
OUTLIER, LEFT = 4.0, 0.92
"""Cap of a squared difference, in expected ones, beyond which it is a corner, not jitter; and the
share of the mean square of normal errors that this leaves."""
ROUNDS = 3
"""Iterations of the jitter's estimate; from 0.1 deg these are enough for 0.02 to 0.3 deg."""
APART, FLAT = 3, 0.97
"""Lines to either side, and the least cosine of the normals there, of a flat surface (14 deg)."""
SIGNIFICANT = 3.0
"""Jitter counts if its square is this many times the square's error."""
LEAST_SIGMA = 0.0005
"""Readings are never believed to be better than this [m]: half of the usual 1 mm resolution."""
USUAL = 0.004, 0.0009
"""Range sigma at 0 [m] and its growth per metre of a URG-04LX, where nothing else is known."""


def estimate_range_noise(
    ranges: FloatArray, valid: BoolArray, rays: FloatArray | None = None
) -> tuple[float, float]:
    """Return ``range_sigma`` and ``range_sigma_per_metre`` of a sweep; as usual if it is too small.

    Along a line the inverse range of a plane is linear but for terms of second order in the beam
    angle, so that its second difference is noise: the median of |d2 q| r^2 / sqrt(6) over each
    quarter of the readings by range, and a straight line through the four.

    Args:
        ranges: (n_lines, n_beams) [m].
        valid: Readings that are distances (n_lines, n_beams).
        rays: Directions of unevenly spaced beams (n_lines, n_beams, 3).
    """
    n_beams = ranges.shape[1] - 2 * LAG
    whole = valid[:, LAG:-LAG] & valid[:, 2 * LAG :] & valid[:, : -2 * LAG]
    every = np.flatnonzero(whole)
    if len(every) < MIN_READINGS:
        return USUAL
    some = every[:: max(1, len(every) // MOST_READINGS)]
    line = some // n_beams
    beam = some - line * n_beams
    before, r, after = ranges[line, beam], ranges[line, beam + LAG], ranges[line, beam + 2 * LAG]
    a, b = np.ones((2, len(r)))
    if rays is not None:
        middle = rays[line, beam + LAG]
        a = np.linalg.norm(middle - rays[line, beam], axis=1)
        b = np.linalg.norm(rays[line, beam + 2 * LAG] - middle, axis=1)
    second = (b / before - (a + b) / r + a / after) / np.sqrt(a**2 + b**2 + (a + b) ** 2)
    deviation = np.abs(second) * r * r * MAD
    quarter, share = quarters(r), np.zeros(4)
    x, y = np.zeros(4), np.zeros(4)
    for k in range(4):
        part = np.flatnonzero(quarter == k)
        if len(part) > 0:
            share[k] = len(part) / len(r)
            x[k] = np.sum(r[part]) / len(part)
            y[k] = np.partition(deviation[part], len(part) // 2)[len(part) // 2]
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


def line_residuals(
    ranges: FloatArray,
    yaws: FloatArray,
    lever: FloatArray,
    rows: FloatArray,
    index: SmallIntArray,
) -> FloatArray:
    """Return sum w l e and sum w l^2 of each line (n_lines, 2) over its surfels.

    e is the reading's distance from its surfel along the normal n, l = n . (e_z x P) what a yaw
    error of the line makes of it per radian, w the inverse variance by range noise. Only surfels
    count that are ``FLAT`` across lines: where the surface bends, its planes are off by themselves.

    Args:
        ranges: (n_lines, n_beams) [m].
        yaws: (n_lines, n_beams) [rad].
        lever: Place of the lidar in ``base`` (3,) [m].
        rows: Surfels (m, 8).
        index: Row of each reading (n_lines, n_beams), or -1.
    """
    flat = index >= 0
    normals = np.where(flat[..., None], rows[index, 3:6], 0.0)
    alike = np.sum(normals[APART:] * normals[:-APART], axis=2) > FLAT
    flat[:APART], flat[-APART:] = False, False
    flat[APART:] &= alike
    flat[:-APART] &= alike
    line, beam = np.nonzero(flat)
    rows, yaw = rows[index[line, beam]], yaws[line, beam]
    c, s = np.cos(yaw), np.sin(yaw)
    ray = rows[:, :3].copy()
    ray[:, 0] -= c * lever[0] - s * lever[1]
    ray[:, 1] -= s * lever[0] + c * lever[1]
    ray[:, 2] -= lever[2]
    share = ranges[line, beam] / np.sqrt(np.sum(ray * ray, axis=1)) - 1.0
    e = share * np.sum(ray * rows[:, 3:6], axis=1)
    swing = rows[:, 4] * rows[:, 0] - rows[:, 3] * rows[:, 1]
    weighted = swing / rows[:, 6]
    return np.stack([np.bincount(line, weighted * v, len(ranges)) for v in (e, swing)], axis=1)


def yaw_jitter(sums: FloatArray) -> float:
    """Return the standard deviation [rad] of the lines' yaws from ``line_residuals``; 0 if none.

    The error d of a line by itself is sum w l e / sum w l^2, of variance 1 / sum w l^2. Of three
    neighbours d1 - 2 d2 + d3 has 6 sigma^2 more than follows from that.
    """
    known = sums[:, 1] > 0
    three = np.flatnonzero(known[:-2] & known[1:-1] & known[2:])
    if len(three) < MIN_LINES:
        return 0.0
    weight = np.where(known, sums[:, 1], 1.0)
    own, d = 1.0 / weight, sums[:, 0] / weight
    square = (d[three] - 2 * d[three + 1] + d[three + 2]) ** 2 / 6
    expected = (own[three] + 4 * own[three + 1] + own[three + 2]) / 6
    jitter = LIKELY_JITTER**2
    for _ in range(ROUNDS):
        likely = expected + jitter
        weights = 1.0 / likely**2
        excess = np.sum(weights * (np.minimum(square, OUTLIER * likely) / LEFT - expected))
        excess /= np.sum(weights)
        jitter = max(excess, 0.0)
    error = math.sqrt(4.0 * np.sum((weights * expected) ** 2)) / np.sum(weights)
    return math.sqrt(excess) if excess > SIGNIFICANT * error else 0.0
