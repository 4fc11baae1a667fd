"""Compiled twins of the array functions of the same names in ``edges``; numba is needed.

Loops instead of arrays, and the same results: method and arguments are described there.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration import edges
from scan3d_twin.core.registration.edges import (
    EMPTY,
    INWARDS,
    JUMP,
    MIN_BEAMS,
    MIN_COSINE,
    MIN_FLAT,
    MIN_HEIGHT,
    MOST_SPREAD,
    OFF_PLANE,
)
from scan3d_twin.core.registration.jit import jit, twin_of


@jit
def edge_rows(ranges, yaws, beams, lever, rows, index, valid, yaw_sigma):  # type: ignore[no-untyped-def]
    """See ``edges.edge_rows``."""
    n_lines, n_beams = ranges.shape
    places, jumps = np.empty((n_beams, 3)), np.empty(n_beams, dtype=np.bool_)
    variance = np.mean(np.abs(yaws[1] - yaws[0])) ** 2 / 12 + yaw_sigma**2
    lows, highs = _carrying(index)
    found, count = np.empty((2 * np.sum((highs - lows) // MIN_BEAMS), 8)), 0
    for side in (1, -1):
        for pair in range(n_lines - 1):
            near = pair if side > 0 else pair + 1
            inner = near - INWARDS * side
            if not 0 <= inner < n_lines or highs[inner] - lows[inner] < MIN_BEAMS:
                continue
            low, high = lows[inner], highs[inner]
            if _mark(ranges, index, valid, near, side, low, high, jumps) < MIN_BEAMS:
                continue
            first = -1
            for j in range(low, high + 1):
                if j < high and jumps[j]:
                    first = j if first < 0 else first
                    continue
                if first >= 0 and j - first >= MIN_BEAMS:
                    n = _places(
                        ranges[near], yaws[near], yaws[near + side], beams, lever,
                        rows, index[near - INWARDS * side], first, j, places,
                    )  # fmt: skip
                    count += _edge(places[:n], variance, side, found[count])
                first = -1
    return found[:count].copy()


@jit
def _carrying(index):  # type: ignore[no-untyped-def]
    """Return the first beam with a surfel of each line, and the end (n_lines,); 0 and 0 if none."""
    lows, highs = np.zeros(len(index), np.int64), np.zeros(len(index), np.int64)
    for i in range(len(index)):
        low, high = 0, index.shape[1]
        while low < high and index[i, low] < 0:
            low += 1
        while high > low and index[i, high - 1] < 0:
            high -= 1
        lows[i], highs[i] = low, high
    return lows, highs


@jit
def _mark(ranges, index, valid, near, side, low, high, out):  # type: ignore[no-untyped-def]
    """Write at which beams the surface on line ``near`` ends towards ``side``; return how many.

    Only beams ``low`` to ``high`` are looked at.
    """
    n, inner = 0, near - INWARDS * side
    for j in range(low, high):
        out[j] = False
        if not valid[near, j]:
            continue
        if valid[near + side, j]:
            out[j] = ranges[near + side, j] - ranges[near, j] > JUMP
        else:
            k = 2
            while (
                k <= EMPTY and 0 <= near + k * side < len(valid) and not valid[near + k * side, j]
            ):
                k += 1
            out[j] = k > EMPTY
        out[j] = out[j] and index[inner, j] >= 0
        n += out[j]
    return n


@jit
def _places(ranges, yaws, next_yaws, beams, lever, rows, index, first, end, out):  # type: ignore[no-untyped-def]
    """Write x, y of the edge and z of the surfel for each upright beam of a run; return how many.

    All but the surfels ``rows`` are of single lines: of the last readings and of those that carry
    them.
    """
    n = 0
    for j in range(first, end):
        c, s = math.cos(yaws[j]), math.sin(yaws[j])
        bx, by = lever[0] + ranges[j] * beams[j, 0], lever[1] + ranges[j] * beams[j, 1]
        x, y, z = c * bx - s * by, s * bx + c * by, lever[2] + ranges[j] * beams[j, 2]
        q = rows[index[j]]
        off = abs(q[3] * (x - q[0]) + q[4] * (y - q[1]) + q[5] * (z - q[2]))
        middle = (yaws[j] + next_yaws[j]) / 2
        c, s = math.cos(middle), math.sin(middle)
        facing = q[3] * c + q[4] * s
        flat = math.sqrt(q[3] * q[3] + q[4] * q[4])
        if -facing > MIN_COSINE and flat > MIN_FLAT and off < OFF_PLANE:
            rho = (q[3] * q[0] + q[4] * q[1]) / facing
            out[n, 0], out[n, 1], out[n, 2] = rho * c, rho * s, q[2]
            n += 1
    return n


@jit
def _edge(places, spread, side, out):  # type: ignore[no-untyped-def]
    """Write the edge through ``places`` (n, 3); return 1, or 0 if it is none."""
    n = len(places)
    if n < MIN_BEAMS:
        return 0
    low, high = places[:, 2].min(), places[:, 2].max()
    if high - low < MIN_HEIGHT:
        return 0
    x, y = places[:, 0].mean(), places[:, 1].mean()
    scatter = 0.0
    for i in range(n):
        scatter += (places[i, 0] - x) ** 2 + (places[i, 1] - y) ** 2
    if math.sqrt(scatter / n) > MOST_SPREAD:
        return 0
    distance = math.sqrt(x * x + y * y)
    out[0], out[1], out[2], out[3] = x, y, -y / distance, x / distance
    out[4], out[5], out[6], out[7] = distance * distance * spread, side, low, high
    return 1


@twin_of(edges.edge_sums)
def edge_sums(target, source, T, distance, robust):  # type: ignore[no-untyped-def]
    """See ``edges.edge_sums``."""
    H, g, J = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    c2 = robust * robust
    for i in range(len(source)):
        s = source[i]
        x, y = T[0, 0] * s[0] + T[0, 1] * s[1], T[1, 0] * s[0] + T[1, 1] * s[1]
        pick, best = -1, distance * distance
        for k in range(len(target)):
            q = target[k]
            if s[5] != q[5] or min(s[7], q[7]) <= max(s[6], q[6]):
                continue
            far = (x + T[0, 3] - q[0]) ** 2 + (y + T[1, 3] - q[1]) ** 2
            if far < best:
                pick, best = k, far
        if pick < 0:
            continue
        q = target[pick]
        e = q[2] * (x + T[0, 3] - q[0]) + q[3] * (y + T[1, 3] - q[1])
        variance = s[4] + q[4]
        w = (c2 / (c2 + e * e / variance)) ** 2 / variance
        J[0], J[1], J[5] = q[2], q[3], q[3] * x - q[2] * y
        for a in (0, 1, 5):
            g[a] += w * J[a] * e
            for b in (0, 1, 5):
                H[a, b] += w * J[a] * J[b]
    return H, g
