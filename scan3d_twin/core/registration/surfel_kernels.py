"""Compiled twins of the array functions of the same names in ``surfels`` and ``scan_noise``.

Loops instead of arrays, and the same results: method and arguments are described there.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration import scan_noise, surfels
from scan3d_twin.core.registration.jit import inlined, jit, twin_of
from scan3d_twin.core.registration.scan_noise import APART, FLAT
from scan3d_twin.core.registration.surfels import FILLED, MIN_COSINE, MOMENTS, TOLERANCE

MOST_TURNED = 0.03
"""Up to here the terms that ``_turn`` leaves out are below 1e-12 [rad]."""
WIDE = 128
"""Beams at once: some 30 kB of ``work``, which stays in the fastest cache."""
AREA, RAY, EYE, Q, SIGMA, FOUND, COLUMNS = 11, 12, 15, 17, 18, 19, 27
"""Columns of ``work`` after the moments: readings of a whole window, the ray (3) and the lidar's
place (2) in ``scan``, inverse range, sigma of the range, and the surfels (8)."""


@inlined
def _turn(angle, c, s):  # type: ignore[no-untyped-def]
    """Return cos and sin of a small ``angle`` [rad] more than the angle of cosine c and sine s."""
    square = angle * angle
    dc = 1.0 - square * (0.5 - square * (1 / 24 - square / 720))
    ds = angle * (1.0 - square * (1 / 6 - square * (1 / 120 - square / 5040)))
    return c * dc - s * ds, s * dc + c * ds


@twin_of(surfels.fit_surfels)
def fit_surfels(ranges, yaws, beams, lever, valid, keep, noise, windows):  # type: ignore[no-untyped-def]
    """See ``surfels.fit_surfels``; of the summed-area table only the rows in use are kept.

    The beams of a line are taken together, ``WIDE`` at once, as the columns of ``work``.
    """
    n_lines, n_beams = ranges.shape
    half, margin = windows[:, 0].max(), windows[:, 1].max()
    depth = 2 * half + 2
    sums, turns = np.zeros((depth, MOMENTS, n_beams + 1 + 2 * margin)), np.empty((2, n_beams))
    rows, index = np.empty((np.sum(keep), 8)), np.full((n_lines, n_beams), -1, np.int32)
    of_rows = np.empty(len(rows))
    work, n, summed = np.empty(COLUMNS * WIDE), 0, 0
    for i in range(n_lines):
        while summed < min(i + half + 1, n_lines):
            _turns(yaws[summed], turns)
            _add_line(
                ranges[summed], beams, lever, valid[summed], turns, margin, sums[summed % depth],
                sums[(summed + 1) % depth],
            )  # fmt: skip
            summed += 1
        if not keep[i].any():
            continue
        _turns(yaws[i], turns)
        for start in range(0, n_beams, WIDE):
            first, end = _wanted(keep[i], start, min(start + WIDE, n_beams))
            _look(ranges[i], beams, lever, turns, noise, first, end - first, work)
            pending = end - first
            for k in range(len(windows)):
                if pending == 0:
                    break
                l0, l1 = max(i - windows[k, 0], 0), min(i + windows[k, 0] + 1, n_lines)
                _moments(
                    sums[l0 % depth], sums[l1 % depth], margin, windows[k, 1], l1 - l0, n_beams,
                    first, pending, work,
                )  # fmt: skip
                _planes(pending, lever[2], noise[2] ** 2, l1 - l0, work)
                pending = _pending(keep[i, first:], work, pending)
            n = _take(keep[i], yaws[i], work, first, end, rows, of_rows, index[i], n)
    return rows[:n], of_rows[:n], index


@jit
def _turns(yaws, turns):  # type: ignore[no-untyped-def]
    """Write cos and sin (2, n) of a line's yaws."""
    c0, s0, turned = math.cos(yaws[0]), math.sin(yaws[0]), 0.0
    for j in range(len(yaws)):
        turned = max(turned, abs(yaws[j] - yaws[0]))
    if turned > MOST_TURNED:
        for j in range(len(yaws)):
            turns[0, j], turns[1, j] = math.cos(yaws[j]), math.sin(yaws[j])
    else:
        for j in range(len(yaws)):
            turns[0, j], turns[1, j] = _turn(yaws[j] - yaws[0], c0, s0)


@jit
def _add_line(ranges, beams, lever, valid, turns, margin, above, below):  # type: ignore[no-untyped-def]
    """Write a line's row of the summed-area table (11, n + 1 + 2 margin) ``below`` another."""
    used = np.flatnonzero(valid)
    first, end = (used[0], used[-1] + 1) if len(used) > 0 else (0, 0)
    xx, xy, xz, yy, yz, zz, xq, yq, zq, qq, n = (
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip
    for j in range(first, end):
        if valid[j]:
            c, s, q = turns[0, j], turns[1, j], 1.0 / ranges[j]
            bx, by = beams[j, 0] + q * lever[0], beams[j, 1] + q * lever[1]
            x, y, z = c * bx - s * by, s * bx + c * by, beams[j, 2] + q * lever[2]
            xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
            yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
            xq, yq, zq, qq, n = xq + x * q, yq + y * q, zq + z * q, qq + q * q, n + 1.0
        at = margin + 1 + j
        below[0, at], below[1, at] = above[0, at] + xx, above[1, at] + xy
        below[2, at], below[3, at] = above[2, at] + xz, above[3, at] + yy
        below[4, at], below[5, at] = above[4, at] + yz, above[5, at] + zz
        below[6, at], below[7, at] = above[6, at] + xq, above[7, at] + yq
        below[8, at], below[9, at] = above[8, at] + zq, above[9, at] + qq
        below[10, at] = above[10, at] + n
    whole = (xx, xy, xz, yy, yz, zz, xq, yq, zq, qq, n)
    for m in range(MOMENTS):
        for at in range(margin + 1 + first):
            below[m, at] = above[m, at]
        for at in range(margin + 1 + end, below.shape[1]):
            below[m, at] = above[m, at] + whole[m]


@jit
def _look(ranges, beams, lever, turns, noise, first, n, work):  # type: ignore[no-untyped-def]
    """Write ray, place of the lidar, inverse range and noise of ``n`` beams."""
    l_x, l_y, at_zero, per_metre = lever[0], lever[1], noise[0], noise[1]
    for k in range(n):
        j = first + k
        c, s = turns[0, j], turns[1, j]
        work[RAY * WIDE + k] = c * beams[j, 0] - s * beams[j, 1]
        work[(RAY + 1) * WIDE + k] = s * beams[j, 0] + c * beams[j, 1]
        work[(RAY + 2) * WIDE + k] = beams[j, 2]
        work[EYE * WIDE + k], work[(EYE + 1) * WIDE + k] = c * l_x - s * l_y, s * l_x + c * l_y
        work[Q * WIDE + k] = 1.0 / ranges[j]
        work[SIGMA * WIDE + k] = at_zero + per_metre * ranges[j]
        work[(FOUND + 6) * WIDE + k] = 0.0


@jit
def _moments(above, below, margin, half, n_lines, n_beams, first, n, work):  # type: ignore[no-untyped-def]
    """Write moments and area of the windows of ``half`` around ``n`` beams."""
    left = max(margin + first - half, 0)  # as it is: indices below 0 would keep registers narrow
    right = left + max(2 * half + 1, 0)
    for m in range(MOMENTS):
        A, B, out = above[m], below[m], work[m * WIDE : (m + 1) * WIDE]
        for k in range(n):
            out[k] = (B[right + k] - A[right + k]) - (B[left + k] - A[left + k])
    area = work[AREA * WIDE : (AREA + 1) * WIDE]
    for k in range(n):
        area[k] = n_lines * (min(first + k + half + 1, n_beams) - max(first + k - half, 0))


@jit
def _planes(n, height, yaw_variance, lines, w):  # type: ignore[no-untyped-def]
    """Write the surfels of windows where none was found yet; where none fits the variance stays 0.

    ``height`` is that of the lidar; the columns of ``w`` are those of ``work``.
    """
    per_line = 1.0 + TOLERANCE * math.sqrt(2.0 / lines)
    for j in range(n):
        xx, xy, xz, yy, yz, zz = (
            w[j], w[WIDE + j], w[2 * WIDE + j], w[3 * WIDE + j], w[4 * WIDE + j], w[5 * WIDE + j],
        )  # fmt: skip
        bx, by, bz = w[6 * WIDE + j], w[7 * WIDE + j], w[8 * WIDE + j]
        qq, readings, area = w[9 * WIDE + j], w[10 * WIDE + j], w[AREA * WIDE + j]
        dx, dy, dz = w[RAY * WIDE + j], w[(RAY + 1) * WIDE + j], w[(RAY + 2) * WIDE + j]
        ox, oy = w[EYE * WIDE + j], w[(EYE + 1) * WIDE + j]
        q, sigma = w[Q * WIDE + j], w[SIGMA * WIDE + j]
        c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        det, trace = xx * c_xx + xy * c_xy + xz * c_xz, xx + yy + zz
        inv = 1.0 / det
        mx = (c_xx * bx + c_xy * by + c_xz * bz) * inv
        my = (c_xy * bx + c_yy * by + c_yz * bz) * inv
        mz = (c_xz * bx + c_yz * by + c_zz * bz) * inv
        along = mx * dx + my * dy + mz * dz
        square = mx * mx + my * my + mz * mz
        r = (1.0 - (mx * ox + my * oy + mz * height)) / along
        by_range = along * along * sigma * sigma
        scatter = q * q * by_range
        rss = qq - mx * bx - my * by - mz * bz
        x, y, z = ox + r * dx, oy + r * dy, height + r * dz
        swing = my * x - mx * y
        by_yaw = readings * q * q * swing * swing * yaw_variance * per_line
        free = max(readings - 3.0, 1.0)
        fits = (
            (readings >= FILLED * area) & (readings > 5.0) & (det > 1e-12 * trace * trace * trace)
        )
        most = scatter * (free + TOLERANCE * math.sqrt(2.0 * free)) + by_yaw
        fits &= (rss <= most) & (r > 0.0)
        fits &= along * along > MIN_COSINE**2 * square
        fits &= w[(FOUND + 6) * WIDE + j] == 0.0
        quadratic = mx * (c_xx * mx + 2.0 * (c_xy * my + c_xz * mz))
        quadratic += my * (c_yy * my + 2.0 * c_yz * mz) + c_zz * mz * mz
        tangents = (c_xx + c_yy + c_zz - quadratic / square) * inv
        towards = math.copysign(1.0, -along) / math.sqrt(square)
        _keep(w, FOUND * WIDE + j, x, fits)
        _keep(w, (FOUND + 1) * WIDE + j, y, fits)
        _keep(w, (FOUND + 2) * WIDE + j, z, fits)
        _keep(w, (FOUND + 3) * WIDE + j, towards * mx, fits)
        _keep(w, (FOUND + 4) * WIDE + j, towards * my, fits)
        _keep(w, (FOUND + 5) * WIDE + j, towards * mz, fits)
        _keep(w, (FOUND + 6) * WIDE + j, by_range / square, fits)
        _keep(w, (FOUND + 7) * WIDE + j, tangents * scatter / (2.0 * square), fits)


@inlined
def _keep(w, at, value, fits):  # type: ignore[no-untyped-def]
    before = w[at]
    w[at] = value if fits else before


@jit
def _wanted(keep, first, end):  # type: ignore[no-untyped-def]
    """Return the first and the end of the beams of a part of a line that get a surfel."""
    while first < end and not keep[first]:
        first += 1
    while first < end and not keep[end - 1]:
        end -= 1
    return first, end


@jit
def _pending(keep, work, n):  # type: ignore[no-untyped-def]
    """Return how many of the first ``n`` beams there are up to the last that has no surfel yet."""
    while n > 0 and (not keep[n - 1] or work[(FOUND + 6) * WIDE + n - 1] > 0.0):
        n -= 1
    return n


@jit
def _take(keep, yaws, work, first, end, rows, of_rows, index, n):  # type: ignore[no-untyped-def]
    """Append the surfels of beams ``first`` to ``end``; return how many there are."""
    for j in range(first, end):
        if keep[j] and work[(FOUND + 6) * WIDE + j - first] > 0.0:
            for m in range(8):
                rows[n, m] = work[(FOUND + m) * WIDE + j - first]
            index[j], of_rows[n] = n, yaws[j]
            n += 1
    return n


@twin_of(scan_noise.line_residuals)
def line_residuals(ranges, yaws, lever, rows, index):  # type: ignore[no-untyped-def]
    """See ``scan_noise.line_residuals``."""
    n_lines, n_beams = ranges.shape
    sums, turns = np.zeros((n_lines, 2)), np.empty((2, n_beams))
    for i in range(APART, n_lines - APART):
        _turns(yaws[i], turns)
        for j in range(n_beams):
            here, before, after = index[i, j], index[i - APART, j], index[i + APART, j]
            if here < 0 or before < 0 or after < 0:
                continue
            if not (_flat(rows, here, before) and _flat(rows, here, after)):
                continue
            c, s = turns[0, j], turns[1, j]
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


@jit
def sampled(rows, yaws, index, stride):  # type: ignore[no-untyped-def]
    """See ``scan_arrays.sampled``."""
    first, n = stride // 2, 0
    most = min(len(rows), (len(index) // stride + 1) * (index.shape[1] // stride + 1))
    lines, chosen = np.empty(most + 1, np.int32), np.empty(most + 1, np.int32)
    for i in range(first, len(index), stride):
        for j in range(first, index.shape[1], stride):
            lines[n], chosen[n] = i, index[i, j]
            n += index[i, j] >= 0
    if stride == 1:
        return rows, yaws, lines[:n]
    some, of_some = np.empty((n, 8)), np.empty(n)
    for m in range(n):
        some[m], of_some[m] = rows[chosen[m]], yaws[chosen[m]]
    return some, of_some, lines[:n]
