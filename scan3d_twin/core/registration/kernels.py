"""Compiled twins of the array functions of the same names; numba (extra ``fast``) is needed.

Loops instead of arrays, and the same results: method and arguments are described there.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from scan3d_twin.core.registration.edge_kernels import edge_rows, edge_sums
from scan3d_twin.core.registration.free_space import MARGIN, SIGMAS
from scan3d_twin.core.registration.point_to_plane import (
    MIN_NORMAL_COSINE,
    MOST_ALONG_RAY,
    MOST_LINES,
)
from scan3d_twin.core.registration.projection import CELLS
from scan3d_twin.core.registration.scan_noise import APART, FLAT
from scan3d_twin.core.registration.surfels import (
    EMPTY,
    FILLED,
    MIN_COSINE,
    MOMENTS,
    TOLERANCE,
    UNKNOWN,
)

__all__ = (
    "edge_rows", "edge_sums", "fit_surfels", "line_residuals", "normal_equations", "violations",
)  # fmt: skip

_jit = njit(cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"})


@_jit
def _turn(angle, c, s):  # type: ignore[no-untyped-def]
    """Return cos and sin of ``angle`` [rad] more than the angle of cosine c and sine s."""
    if abs(angle) > 0.03:
        dc, ds = math.cos(angle), math.sin(angle)
    else:  # the next terms are below 1e-12
        square = angle * angle
        dc = 1.0 - square * (0.5 - square * (1 / 24 - square / 720))
        ds = angle * (1.0 - square * (1 / 6 - square * (1 / 120 - square / 5040)))
    return c * dc - s * ds, s * dc + c * ds


@_jit
def _frames(ranges, yaws, beams, lever, valid):  # type: ignore[no-untyped-def]
    """Return the summed-area table and cos and sin of each yaw."""
    n_lines, n_beams = ranges.shape
    sums = np.zeros((n_lines + 1, n_beams + 1, MOMENTS))
    turns = np.empty((n_lines, n_beams, 2))
    row = np.empty(MOMENTS)
    for i in range(n_lines):
        c0, s0 = math.cos(yaws[i, 0]), math.sin(yaws[i, 0])
        row[:] = 0.0
        for j in range(n_beams):
            c, s = _turn(yaws[i, j] - yaws[i, 0], c0, s0)
            turns[i, j, 0], turns[i, j, 1] = c, s
            if valid[i, j]:
                q = 1.0 / ranges[i, j]
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
                sums[i + 1, j + 1, m] = sums[i, j + 1, m] + row[m]
    return sums, turns


@_jit
def _plane(T, area, ox, oy, oz, dx, dy, dz, q, noise, out):  # type: ignore[no-untyped-def]
    """Write the surfel of a window with moments ``T`` (11,); tell whether it fits."""
    n = T[10]
    if n < FILLED * area or n <= 5:
        return False
    xx, xy, xz, yy, yz, zz = T[0], T[1], T[2], T[3], T[4], T[5]
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    det = xx * c_xx + xy * c_xy + xz * c_xz
    if det <= 1e-12 * (xx + yy + zz) ** 3:
        return False
    inv = 1.0 / det
    mx = (c_xx * T[6] + c_xy * T[7] + c_xz * T[8]) * inv
    my = (c_xy * T[6] + c_yy * T[7] + c_yz * T[8]) * inv
    mz = (c_xz * T[6] + c_yz * T[7] + c_zz * T[8]) * inv
    square = mx * mx + my * my + mz * mz
    along = mx * dx + my * dy + mz * dz
    if along * along <= MIN_COSINE**2 * square:
        return False
    r = (1.0 - (mx * ox + my * oy + mz * oz)) / along
    if r <= 0:
        return False
    px, py, pz = ox + r * dx, oy + r * dy, oz + r * dz
    by_range = (along * (noise[0] + noise[1] / q)) ** 2
    scatter = q * q * by_range
    rss = T[9] - mx * T[6] - my * T[7] - mz * T[8]
    if rss > scatter * (n - 3) * (1 + TOLERANCE * math.sqrt(2 / (n - 3))):
        return False
    quadratic = mx * (c_xx * mx + 2 * (c_xy * my + c_xz * mz)) + my * (c_yy * my + 2 * c_yz * mz)
    tangents = (c_xx + c_yy + c_zz - (quadratic + c_zz * mz * mz) / square) * inv
    towards = -math.copysign(1.0, along) / math.sqrt(square)
    out[0], out[1], out[2] = px, py, pz
    out[3], out[4], out[5] = towards * mx, towards * my, towards * mz
    out[6], out[7] = by_range / square, tangents * scatter / (2 * square)
    return True


@_jit
def fit_surfels(ranges, yaws, beams, lever, valid, keep, noise, windows):  # type: ignore[no-untyped-def]
    """See ``surfels.fit_surfels``."""
    n_lines, n_beams = ranges.shape
    sums, turns = _frames(ranges, yaws, beams, lever, valid)
    table = np.zeros((n_lines, n_beams, 8))
    T = np.empty(MOMENTS)
    for i in range(n_lines):
        for j in range(n_beams):
            if not keep[i, j]:
                continue
            c, s, q = turns[i, j, 0], turns[i, j, 1], 1.0 / ranges[i, j]
            ox, oy = c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]
            dx, dy = c * beams[j, 0] - s * beams[j, 1], s * beams[j, 0] + c * beams[j, 1]
            for k in range(len(windows)):
                l0, l1 = max(i - windows[k, 0], 0), min(i + windows[k, 0] + 1, n_lines)
                b0, b1 = max(j - windows[k, 1], 0), min(j + windows[k, 1] + 1, n_beams)
                for m in range(MOMENTS):
                    T[m] = (sums[l1, b1, m] - sums[l0, b1, m]) - (sums[l1, b0, m] - sums[l0, b0, m])
                area = float((l1 - l0) * (b1 - b0))
                if _plane(T, area, ox, oy, lever[2], dx, dy, beams[j, 2], q, noise, table[i, j]):
                    break
    return table


@_jit
def _flat(a, b):  # type: ignore[no-untyped-def]
    return a[3] * b[3] + a[4] * b[4] + a[5] * b[5] > FLAT


@_jit
def line_residuals(ranges, yaws, lever, table):  # type: ignore[no-untyped-def]
    """See ``scan_noise.line_residuals``."""
    n_lines, n_beams = ranges.shape
    sums = np.zeros((n_lines, 2))
    for i in range(APART, n_lines - APART):
        c0, s0 = math.cos(yaws[i, 0]), math.sin(yaws[i, 0])
        for j in range(n_beams):
            row = table[i, j]
            if row[6] == 0 or not (
                _flat(row, table[i - APART, j]) and _flat(row, table[i + APART, j])
            ):
                continue
            c, s = _turn(yaws[i, j] - yaws[i, 0], c0, s0)
            x = row[0] - (c * lever[0] - s * lever[1])
            y = row[1] - (s * lever[0] + c * lever[1])
            z = row[2] - lever[2]
            share = ranges[i, j] / math.sqrt(x * x + y * y + z * z) - 1.0
            e = share * (x * row[3] + y * row[4] + z * row[5])
            swing = row[4] * row[0] - row[3] * row[1]
            sums[i, 0] += swing / row[6] * e
            sums[i, 1] += swing / row[6] * swing
    return sums


@_jit
def _cell(angle):  # type: ignore[no-untyped-def]
    turns = angle * (1.0 / math.tau)
    return int((turns - math.floor(turns)) * CELLS) % CELLS


@_jit
def _branch(x, y, z, sign, lines, beams, offsets, mount):  # type: ignore[no-untyped-def]
    """Return the flat index of the reading that sees a point, ahead (1) or behind (-1), or -1."""
    rho = max(math.sqrt(x * x + y * y), 1e-9)
    sine = min(1.0, max(-1.0, (mount[4] - mount[5] * z) / (mount[3] * rho)))
    cosine = sign * math.sqrt(1.0 - sine * sine)
    forward = rho * (mount[0] * cosine - mount[1] * sine) - mount[6]
    left = rho * (mount[1] * cosine + mount[0] * sine) - mount[7]
    up = z - mount[8]
    elevation = math.atan2(
        forward * mount[12] + left * mount[13] + up * mount[14],
        forward * mount[9] + left * mount[10] + up * mount[11],
    )
    beam = beams[_cell(elevation)]
    if beam < 0:
        return -1
    yaw = math.atan2(y, x) - mount[2]
    if sine != 0.0 or sign < 0:
        yaw -= math.atan2(sine, cosine)
    line = lines[_cell(yaw)]
    line = lines[_cell(yaw - offsets[line, beam])]
    return line * offsets.shape[1] + beam if line >= 0 else -1


@_jit
def normal_equations(  # type: ignore[no-untyped-def]
    table, yaws, middle_yaw, lines, beams, offsets, mount,
    rows, source_yaws, source_lines, T, limits,
):  # fmt: skip
    """See ``point_to_plane.normal_equations``."""
    distance, robust, area, scale, jitter, target_jitter, density, share, tilt = limits
    c2, farthest = robust * robust, (MOST_ALONG_RAY * distance) ** 2
    H, lost, b, JJ = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros(7), np.zeros((6, 6))
    first, second = np.zeros(3), np.zeros((3, 3))
    J, a, h = np.empty(7), np.empty(3), np.zeros(9)
    weight, square, pairs, line = 0.0, 0.0, 0, -1
    for m in range(len(rows)):
        row = rows[m]
        for i in range(3):
            a[i] = T[i, 0] * row[0] + T[i, 1] * row[1] + T[i, 2] * row[2]
        x, y, z = a[0] + T[0, 3], a[1] + T[1, 3], a[2] + T[2, 3]
        index = _branch(x, y, z, 1.0, lines, beams, offsets, mount)
        if index < 0 or table[index, 6] == 0:
            index = _branch(x, y, z, -1.0, lines, beams, offsets, mount)
            if index < 0 or table[index, 6] == 0:
                continue
        q = table[index]
        nx = T[0, 0] * row[3] + T[0, 1] * row[4] + T[0, 2] * row[5]
        ny = T[1, 0] * row[3] + T[1, 1] * row[4] + T[1, 2] * row[5]
        nz = T[2, 0] * row[3] + T[2, 1] * row[4] + T[2, 2] * row[5]
        if nx * q[3] + ny * q[4] + nz * q[5] <= MIN_NORMAL_COSINE:
            continue
        nx, ny, nz = nx + q[3], ny + q[4], nz + q[5]
        norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * norm, ny * norm, nz * norm
        ux, uy, uz = x - q[0], y - q[1], z - q[2]
        swing = ny * a[0] - nx * a[1]
        g = source_yaws[m] * swing - (yaws[index] - middle_yaw) * (ny * q[0] - nx * q[1])
        e = nx * ux + ny * uy + nz * uz + g * scale
        if abs(e) >= distance or ux * ux + uy * uy + uz * uz >= farthest:
            continue
        variance, own = row[6] + q[6], 0.0
        if jitter > 0 or target_jitter > 0:
            k = _lines_per_line(nx, ny, a, q, density)
            turn = ny * q[0] - nx * q[1]
            own = math.sqrt(jitter * swing * swing + target_jitter * k * turn * turn)
        w = share * area / variance * (c2 / (c2 + e * e / (variance + own * own))) ** 2
        J[0], J[1], J[2], J[6] = nx, ny, nz, g
        J[3], J[4], J[5] = a[1] * nz - a[2] * ny, a[2] * nx - a[0] * nz, swing
        if own > 0:
            if source_lines[m] != line:
                _take_line(lost, b, h, area)
                line = source_lines[m]
            own = math.copysign(own, swing)
            for i in range(7):
                h[i] += w * own * J[i]
            h[7] += w * own * e
            h[8] += w * own * own
        nu = w * ((row[7] + q[7]) / 4 + tilt)
        for i in range(7):
            b[i] += w * J[i] * e
            for k in range(i + 1):
                H[i, k] += w * J[i] * J[k]
        for i in range(6):
            for k in range(i + 1):
                JJ[i, k] += nu * J[i] * J[k]
        weight += nu
        for i in range(3):
            first[i] += nu * a[i]
            for k in range(i + 1):
                second[i, k] += nu * a[i] * a[k]
        pairs += 1
        square += e * e
    _take_line(lost, b, h, area)
    faked = _faked(weight, first, _mirrored(second)) - _mirrored(JJ)
    return _mirrored(H), _mirrored(lost), b, faked, pairs, square


@_jit
def _lines_per_line(nx, ny, a, q, density):  # type: ignore[no-untyped-def]
    """Return how many source lines cross the surface for each target line."""
    source = abs(nx * a[0] + ny * a[1]) * (q[0] * q[0] + q[1] * q[1])
    target = abs(nx * q[0] + ny * q[1]) * (a[0] * a[0] + a[1] * a[1])
    return min(MOST_LINES, max(1.0 / MOST_LINES, density * source / max(target, 1e-9)))


@_jit
def _take_line(lost, b, h, area):  # type: ignore[no-untyped-def]
    """Marginalise the yaw error of the line whose sums are in ``h`` (9,), and empty them."""
    share = 1.0 / (math.sqrt(area) + h[8])
    for i in range(7):
        b[i] -= share * h[i] * h[7]
        for k in range(i + 1):
            lost[i, k] += share * h[i] * h[k]
    h[:] = 0.0


@_jit
def _mirrored(lower):  # type: ignore[no-untyped-def]
    for i in range(len(lower)):
        for k in range(i):
            lower[k, i] = lower[i, k]
    return lower


@_jit
def _faked(weight, first, second):  # type: ignore[no-untyped-def]
    """Return sum w nu B B^T (6, 6)."""
    result = np.zeros((6, 6))
    x, y, z = first
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    for i in range(3):
        result[i, i] = weight
        for k in range(3):
            result[3 + i, 3 + k] = -second[i, k]
        result[3 + i, 3 + i] += trace
    result[3, 1], result[3, 2], result[4, 0] = -z, y, z
    result[4, 2], result[5, 0], result[5, 1] = -x, -y, x
    for i in range(3):
        for k in range(3):
            result[k, 3 + i] = result[3 + i, k]
    return result


@_jit
def violations(table, known, lines, beams, offsets, mount, rows, T):  # type: ignore[no-untyped-def]
    """See ``free_space.violations``."""
    cost, seen = 0.0, 0
    for m in range(len(rows)):
        row = rows[m]
        x = T[0, 0] * row[0] + T[0, 1] * row[1] + T[0, 2] * row[2] + T[0, 3]
        y = T[1, 0] * row[0] + T[1, 1] * row[1] + T[1, 2] * row[2] + T[1, 3]
        z = T[2, 0] * row[0] + T[2, 1] * row[1] + T[2, 2] * row[2] + T[2, 3]
        index = _branch(x, y, z, 1.0, lines, beams, offsets, mount)
        if index < 0 or known[index] == UNKNOWN:
            index = _branch(x, y, z, -1.0, lines, beams, offsets, mount)
            if index < 0 or known[index] == UNKNOWN:
                continue
        seen += 1
        if known[index] == EMPTY:
            cost += 1.0
            continue
        q = table[index]
        e = q[3] * (x - q[0]) + q[4] * (y - q[1]) + q[5] * (z - q[2])
        margin = max(MARGIN, SIGMAS * math.sqrt(row[6] + q[6]))
        if e >= -margin:
            cost += min(1.0, (e / margin) ** 2)
    return cost, seen
