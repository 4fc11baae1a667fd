"""Compiled twins of the array functions of the same names in ``point_to_plane`` and ``free_space``.

Loops instead of arrays, and the same results: method and arguments are described there.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration import point_to_plane
from scan3d_twin.core.registration.free_space import MARGIN, SIGMAS
from scan3d_twin.core.registration.jit import jit, twin_of
from scan3d_twin.core.registration.point_to_plane import (
    MIN_NORMAL_COSINE,
    MOST_ALONG_RAY,
    MOST_LINES,
    Equations,
)
from scan3d_twin.core.registration.projection import CELLS
from scan3d_twin.core.registration.surfels import EMPTY, UNKNOWN


@jit
def _cell(c, s):  # type: ignore[no-untyped-def]
    way = s / (abs(c) + abs(s) + 1e-300)
    around = 2.0 - way if c < 0 else (4.0 + way if s < 0 else way)
    return int(around * (CELLS / 4)) & (CELLS - 1)


@jit
def _branch(x, y, z, sign, lines, beams, offsets, mount):  # type: ignore[no-untyped-def]
    """Return the flat index of the reading that sees a point, ahead (1) or behind (-1), or -1."""
    rho = max(math.sqrt(x * x + y * y), 1e-9)
    sine = min(1.0, max(-1.0, (mount[3] - mount[4] * z) / (mount[2] * rho)))
    cosine = sign * math.sqrt(1.0 - sine * sine)
    c, s = mount[0] * cosine - mount[1] * sine, mount[1] * cosine + mount[0] * sine
    forward, left, up = rho * c - mount[5], rho * s - mount[6], z - mount[7]
    beam = beams[
        _cell(
            forward * mount[8] + left * mount[9] + up * mount[10],
            forward * mount[11] + left * mount[12] + up * mount[13],
        )
    ]
    if beam < 0:
        return -1
    cos_yaw, sin_yaw = x * c + y * s, y * c - x * s
    line = lines[_cell(cos_yaw, sin_yaw)]
    turn = offsets[line, beam]
    if turn != 0.0:
        line = lines[_cell(cos_yaw + turn * sin_yaw, sin_yaw - turn * cos_yaw)]
    return line * offsets.shape[1] + beam if line >= 0 else -1


@jit
def lookup(projection, points, seen):  # type: ignore[no-untyped-def]
    """See ``projection.lookup``."""
    lines, beams, offsets, mount = projection
    found = np.empty(len(points), np.int64)
    for m in range(len(points)):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        found[m] = _branch(x, y, z, 1.0, lines, beams, offsets, mount)
        if found[m] < 0 or not seen[found[m]]:
            behind = _branch(x, y, z, -1.0, lines, beams, offsets, mount)
            if behind >= 0 and seen[behind]:
                found[m] = behind
    return found


@twin_of(point_to_plane.normal_equations)
def normal_equations(target, sample, T, scale, gate, both, entries):  # type: ignore[no-untyped-def]
    """See ``point_to_plane.normal_equations``."""
    table, yaws, row_of, (lines, beams, offsets, mount) = target
    rows, source_yaws, source_lines, stride = sample
    jitter, target_jitter, density, share, tilt = both
    area, distance, robust = float(stride * stride), gate.distance, gate.robust
    c2, farthest = robust * robust, (MOST_ALONG_RAY * distance) ** 2
    size = len(entries) + 1
    H, lost, faked = np.zeros((size, size)), np.zeros((size, size)), np.zeros((6, 6))
    b, first, second = np.zeros(size), np.zeros(3), np.zeros((3, 3))
    whole, J, a, h = np.empty(6), np.empty(size), np.empty(3), np.zeros(size + 2)
    weight, square, pairs, line = 0.0, 0.0, 0, -1
    for m in range(len(rows)):
        sx, sy, sz = rows[m, 0], rows[m, 1], rows[m, 2]
        ax = T[0, 0] * sx + T[0, 1] * sy + T[0, 2] * sz
        ay = T[1, 0] * sx + T[1, 1] * sy + T[1, 2] * sz
        az = T[2, 0] * sx + T[2, 1] * sy + T[2, 2] * sz
        x, y, z = ax + T[0, 3], ay + T[1, 3], az + T[2, 3]
        at = _branch(x, y, z, 1.0, lines, beams, offsets, mount)
        if at < 0 or row_of[at] < 0:
            at = _branch(x, y, z, -1.0, lines, beams, offsets, mount)
            if at < 0 or row_of[at] < 0:
                continue
        at = row_of[at]
        sx, sy, sz = rows[m, 3], rows[m, 4], rows[m, 5]
        nx = T[0, 0] * sx + T[0, 1] * sy + T[0, 2] * sz
        ny = T[1, 0] * sx + T[1, 1] * sy + T[1, 2] * sz
        nz = T[2, 0] * sx + T[2, 1] * sy + T[2, 2] * sz
        if nx * table[at, 3] + ny * table[at, 4] + nz * table[at, 5] <= MIN_NORMAL_COSINE:
            continue
        nx, ny, nz = nx + table[at, 3], ny + table[at, 4], nz + table[at, 5]
        norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * norm, ny * norm, nz * norm
        qx, qy, qz = table[at, 0], table[at, 1], table[at, 2]
        ux, uy, uz = x - qx, y - qy, z - qz
        swing, turn = ny * ax - nx * ay, ny * qx - nx * qy
        g = source_yaws[m] * swing - yaws[at] * turn
        e = nx * ux + ny * uy + nz * uz + g * scale
        if abs(e) >= distance or ux * ux + uy * uy + uz * uz >= farthest:
            continue
        variance, own = rows[m, 6] + table[at, 6], 0.0
        if jitter > 0 or target_jitter > 0:
            k = _lines_per_line(nx, ny, ax, ay, qx, qy, density)
            own = math.sqrt(jitter * swing * swing + target_jitter * k * turn * turn)
        w = share * area / variance * (c2 / (c2 + e * e / (variance + own * own))) ** 2
        whole[0], whole[1], whole[2] = nx, ny, nz
        whole[3], whole[4], whole[5] = ay * nz - az * ny, az * nx - ax * nz, swing
        for i in range(size - 1):
            J[i] = whole[entries[i]]
        J[size - 1] = g
        if own > 0:
            if source_lines[m] != line:
                _take_line(lost, b, h, area)
                line = source_lines[m]
            own = math.copysign(own, swing)
            for i in range(size):
                h[i] += w * own * J[i]
            h[size] += w * own * e
            h[size + 1] += w * own * own
        nu = w * ((rows[m, 7] + table[at, 7]) / 4 + tilt)
        for i in range(size):
            b[i] += w * J[i] * e
            for k in range(i + 1):
                H[i, k] += w * J[i] * J[k]
        for i in range(size - 1):
            for k in range(i + 1):
                faked[entries[i], entries[k]] -= nu * J[i] * J[k]
        weight += nu
        a[0], a[1], a[2] = ax, ay, az
        for i in range(3):
            first[i] += nu * a[i]
            for k in range(i + 1):
                second[i, k] += nu * a[i] * a[k]
        pairs += 1
        square += e * e
    _take_line(lost, b, h, area)
    _add_swung(faked, weight, first, second)
    faked = _mirrored(faked)[entries][:, entries]
    return Equations(_mirrored(H), _mirrored(lost), b, faked, pairs, square)


@jit
def _lines_per_line(nx, ny, ax, ay, qx, qy, density):  # type: ignore[no-untyped-def]
    """Return how many source lines cross the surface for each target line."""
    source = abs(nx * ax + ny * ay) * (qx * qx + qy * qy)
    target = abs(nx * qx + ny * qy) * (ax * ax + ay * ay)
    return min(MOST_LINES, max(1.0 / MOST_LINES, density * source / max(target, 1e-9)))


@jit
def _take_line(lost, b, h, area):  # type: ignore[no-untyped-def]
    """Marginalise the yaw error of the line whose sums are in ``h`` (k + 3,), and empty them."""
    size = len(b)
    share = 1.0 / (math.sqrt(area) + h[size + 1])
    for i in range(size):
        b[i] -= share * h[i] * h[size]
        for k in range(i + 1):
            lost[i, k] += share * h[i] * h[k]
    h[:] = 0.0


@jit
def _mirrored(lower):  # type: ignore[no-untyped-def]
    for i in range(len(lower)):
        for k in range(i):
            lower[k, i] = lower[i, k]
    return lower


@jit
def _add_swung(lower, weight, first, second):  # type: ignore[no-untyped-def]
    """Add sum w nu B B^T to the lower triangle of a matrix (6, 6)."""
    x, y, z = first
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    for i in range(3):
        lower[i, i] += weight
        lower[3 + i, 3 + i] += trace
        for k in range(i + 1):
            lower[3 + i, 3 + k] -= second[i, k]
    lower[3, 1] -= z
    lower[3, 2] += y
    lower[4, 0] += z
    lower[4, 2] -= x
    lower[5, 0] -= y
    lower[5, 1] += x


@jit
def violations(target, known, rows, T):  # type: ignore[no-untyped-def]
    """See ``free_space.violations``."""
    table, _, row_of, (lines, beams, offsets, mount) = target
    cost, seen = 0.0, 0
    for m in range(len(rows)):
        sx, sy, sz = rows[m, 0], rows[m, 1], rows[m, 2]
        x = T[0, 0] * sx + T[0, 1] * sy + T[0, 2] * sz + T[0, 3]
        y = T[1, 0] * sx + T[1, 1] * sy + T[1, 2] * sz + T[1, 3]
        z = T[2, 0] * sx + T[2, 1] * sy + T[2, 2] * sz + T[2, 3]
        at = _branch(x, y, z, 1.0, lines, beams, offsets, mount)
        if at < 0 or known[at] == UNKNOWN:
            at = _branch(x, y, z, -1.0, lines, beams, offsets, mount)
            if at < 0 or known[at] == UNKNOWN:
                continue
        seen += 1
        if known[at] == EMPTY:
            cost += 1.0
            continue
        at = row_of[at]
        e = table[at, 3] * (x - table[at, 0]) + table[at, 4] * (y - table[at, 1])
        e += table[at, 5] * (z - table[at, 2])
        margin = max(MARGIN, SIGMAS * math.sqrt(rows[m, 6] + table[at, 6]))
        if e >= -margin:
            cost += min(1.0, (e / margin) ** 2)
    return cost, seen
