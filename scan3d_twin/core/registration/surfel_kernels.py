"""Compiled twins of the array functions of the same names in ``surfels`` and ``scan_noise``.

Loops instead of arrays, and the same results: method and arguments are described there.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration.jit import jit
from scan3d_twin.core.registration.scan_noise import APART, FLAT
from scan3d_twin.core.registration.surfels import FILLED, MIN_COSINE, MOMENTS, TOLERANCE


@jit
def _turn(angle, c, s):  # type: ignore[no-untyped-def]
    """Return cos and sin of ``angle`` [rad] more than the angle of cosine c and sine s."""
    if abs(angle) > 0.03:
        dc, ds = math.cos(angle), math.sin(angle)
    else:  # the next terms are below 1e-12
        square = angle * angle
        dc = 1.0 - square * (0.5 - square * (1 / 24 - square / 720))
        ds = angle * (1.0 - square * (1 / 6 - square * (1 / 120 - square / 5040)))
    return c * dc - s * ds, s * dc + c * ds


@jit
def _add_line(ranges, yaws, beams, lever, valid, above, turns, sums):  # type: ignore[no-untyped-def]
    """Write cos and sin of a line's yaws and its row of the summed-area table below ``above``."""
    c0, s0 = math.cos(yaws[0]), math.sin(yaws[0])
    row = np.zeros(MOMENTS)
    for j in range(len(ranges)):
        c, s = _turn(yaws[j] - yaws[0], c0, s0)
        turns[j, 0], turns[j, 1] = c, s
        if valid[j]:
            q = 1.0 / ranges[j]
            bx, by = beams[j, 0] + q * lever[0], beams[j, 1] + q * lever[1]
            x, y, z = c * bx - s * by, s * bx + c * by, beams[j, 2] + q * lever[2]
            row[0] += x * x
            row[1] += x * y
            row[2] += x * z
            row[3] += y * y
            row[4] += y * z
            row[5] += z * z
            row[6] += x * q
            row[7] += y * q
            row[8] += z * q
            row[9] += q * q
            row[10] += 1.0
        for m in range(MOMENTS):
            sums[j + 1, m] = above[j + 1, m] + row[m]


@jit
def _moments(sums, l0, l1, b0, b1):  # type: ignore[no-untyped-def]
    """Return the 11 moments of the readings of lines l0 to l1 and beams b0 to b1."""
    A, B, C, D = sums[l1, b1], sums[l0, b1], sums[l1, b0], sums[l0, b0]
    return (
        (A[0] - B[0]) - (C[0] - D[0]), (A[1] - B[1]) - (C[1] - D[1]), (A[2] - B[2]) - (C[2] - D[2]),
        (A[3] - B[3]) - (C[3] - D[3]), (A[4] - B[4]) - (C[4] - D[4]), (A[5] - B[5]) - (C[5] - D[5]),
        (A[6] - B[6]) - (C[6] - D[6]), (A[7] - B[7]) - (C[7] - D[7]), (A[8] - B[8]) - (C[8] - D[8]),
        (A[9] - B[9]) - (C[9] - D[9]), (A[10] - B[10]) - (C[10] - D[10]),
    )  # fmt: skip


@jit
def _plane(moments, area, o, d, q, sigma):  # type: ignore[no-untyped-def]
    """Return the surfel of a window as 8 numbers; its variance is 0 if no plane fits."""
    xx, xy, xz, yy, yz, zz, bx, by, bz, qq, n = moments
    none = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if n < FILLED * area or n <= 5:
        return none
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    det = xx * c_xx + xy * c_xy + xz * c_xz
    if det <= 1e-12 * (xx + yy + zz) ** 3:
        return none
    inv = 1.0 / det
    mx = (c_xx * bx + c_xy * by + c_xz * bz) * inv
    my = (c_xy * bx + c_yy * by + c_yz * bz) * inv
    mz = (c_xz * bx + c_yz * by + c_zz * bz) * inv
    along = mx * d[0] + my * d[1] + mz * d[2]
    by_range = (along * sigma) ** 2
    scatter = q * q * by_range
    rss = qq - mx * bx - my * by - mz * bz
    if rss > scatter * (n - 3) * (1 + TOLERANCE * math.sqrt(2 / (n - 3))):
        return none
    square = mx * mx + my * my + mz * mz
    if along * along <= MIN_COSINE**2 * square:
        return none
    r = (1.0 - (mx * o[0] + my * o[1] + mz * o[2])) / along
    if r <= 0:
        return none
    quadratic = mx * (c_xx * mx + 2 * (c_xy * my + c_xz * mz)) + my * (c_yy * my + 2 * c_yz * mz)
    tangents = (c_xx + c_yy + c_zz - (quadratic + c_zz * mz * mz) / square) * inv
    towards = -math.copysign(1.0, along) / math.sqrt(square)
    return (
        o[0] + r * d[0], o[1] + r * d[1], o[2] + r * d[2], towards * mx, towards * my, towards * mz,
        by_range / square, tangents * scatter / (2 * square),
    )  # fmt: skip


@jit
def fit_surfels(ranges, yaws, beams, lever, valid, keep, noise, windows):  # type: ignore[no-untyped-def]
    """See ``surfels.fit_surfels``; of the summed-area table only the rows in use are kept."""
    n_lines, n_beams = ranges.shape
    half = windows[:, 0].max()
    depth = 2 * half + 2
    sums, turns = np.zeros((depth, n_beams + 1, MOMENTS)), np.empty((depth, n_beams, 2))
    rows, index = np.empty((np.sum(keep), 8)), np.full((n_lines, n_beams), -1, np.int32)
    n, summed = 0, 0
    for i in range(n_lines):
        while summed < min(i + half + 1, n_lines):
            _add_line(
                ranges[summed], yaws[summed], beams, lever, valid[summed], sums[summed % depth],
                turns[summed % depth], sums[(summed + 1) % depth],
            )  # fmt: skip
            summed += 1
        for j in range(n_beams):
            if not keep[i, j]:
                continue
            c, s, q = turns[i % depth, j, 0], turns[i % depth, j, 1], 1.0 / ranges[i, j]
            o = (c * lever[0] - s * lever[1], s * lever[0] + c * lever[1], lever[2])
            x, y, z = beams[j, 0], beams[j, 1], beams[j, 2]
            d, sigma = (c * x - s * y, s * x + c * y, z), noise[0] + noise[1] * ranges[i, j]
            for k in range(len(windows)):
                l0, l1 = max(i - windows[k, 0], 0), min(i + windows[k, 0] + 1, n_lines)
                b0, b1 = max(j - windows[k, 1], 0), min(j + windows[k, 1] + 1, n_beams)
                moments = _moments(sums, l0 % depth, l1 % depth, b0, b1)
                surfel = _plane(moments, float((l1 - l0) * (b1 - b0)), o, d, q, sigma)
                if surfel[6] > 0.0:
                    for m in range(8):
                        rows[n, m] = surfel[m]
                    index[i, j] = n
                    n += 1
                    break
    return rows[:n], index


@jit
def line_residuals(ranges, yaws, lever, rows, index):  # type: ignore[no-untyped-def]
    """See ``scan_noise.line_residuals``."""
    n_lines, n_beams = ranges.shape
    sums = np.zeros((n_lines, 2))
    for i in range(APART, n_lines - APART):
        c0, s0 = math.cos(yaws[i, 0]), math.sin(yaws[i, 0])
        for j in range(n_beams):
            here, before, after = index[i, j], index[i - APART, j], index[i + APART, j]
            if here < 0 or before < 0 or after < 0:
                continue
            if not (_flat(rows, here, before) and _flat(rows, here, after)):
                continue
            c, s = _turn(yaws[i, j] - yaws[i, 0], c0, s0)
            x = rows[here, 0] - (c * lever[0] - s * lever[1])
            y = rows[here, 1] - (s * lever[0] + c * lever[1])
            z = rows[here, 2] - lever[2]
            share = ranges[i, j] / math.sqrt(x * x + y * y + z * z) - 1.0
            e = share * (x * rows[here, 3] + y * rows[here, 4] + z * rows[here, 5])
            swing = rows[here, 4] * rows[here, 0] - rows[here, 3] * rows[here, 1]
            sums[i, 0] += swing / rows[here, 6] * e
            sums[i, 1] += swing / rows[here, 6] * swing
    return sums


@jit
def _flat(rows, a, b):  # type: ignore[no-untyped-def]
    """Tell whether two surfels lie on one flat surface."""
    dot = rows[a, 3] * rows[b, 3] + rows[a, 4] * rows[b, 4] + rows[a, 5] * rows[b, 5]
    return dot > FLAT
