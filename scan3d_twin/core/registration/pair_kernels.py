"""Compiled twins of the array functions of the same names in ``point_to_plane`` and ``free_space``.

Loops instead of arrays, and the same results: method and arguments are described there. Those over
a chunk are written for wide registers: columns a constant way apart, no branches, and no indices
that the compiler must take for negative ones.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration import point_to_plane
from scan3d_twin.core.registration.algebra import block
from scan3d_twin.core.registration.free_space import MARGIN, SIGMAS
from scan3d_twin.core.registration.jit import inlined, jit, twin_of
from scan3d_twin.core.registration.point_to_plane import (
    MIN_NORMAL_COSINE,
    MOST_ALONG_RAY,
    MOST_LINES,
    Equations,
)
from scan3d_twin.core.registration.projection import CELLS, QUARTER
from scan3d_twin.core.registration.surfels import EMPTY, UNKNOWN

CHUNK = 256
"""Surfels that are taken at once, as the columns of some scratch memory in the fastest cache."""
SOURCE, TARGET, YAWS, DERIVATIVES, E, WEIGHT, NU, A, OWN, COLUMNS = (
    0, 8, 16, 18, 25, 26, 27, 28, 31, 32,
)  # fmt: skip
"""Columns: both surfels (8 each), their yaws, the derivatives (7) for x y z rx ry rz and the scale,
residual, w, w nu, a (3), and c with its sign; see ``point_to_plane``."""


@inlined
def _around(c, s):  # type: ignore[no-untyped-def]
    """See ``projection.around``."""
    shrunk = 1.0 / (abs(c) + abs(s) + 1e-9)
    way = s * shrunk
    way = 2.0 - way if c < 0 else (4.0 + way if s < 0 else way)
    return QUARTER * way, QUARTER * (c * c + s * s) * shrunk * shrunk


@inlined
def _ways(x, y, z, sign, mount):  # type: ignore[no-untyped-def]
    """Return elevation and yaw under which a point is seen, ahead (1) or behind (-1), and the rate.

    All three in entries of the tables, as ``projection.around`` has them.
    """
    cos_kappa, sin_kappa, a, k_t, k_z, t_x, t_y, t_z, x_x, x_y, x_z, z_x, z_y, z_z = mount
    rho = max(math.sqrt(x * x + y * y), 1e-9)
    sine = min(1.0, max(-1.0, (k_t - k_z * z) / (a * rho)))
    cosine = sign * math.sqrt(1.0 - sine * sine)
    c, s = cos_kappa * cosine - sin_kappa * sine, sin_kappa * cosine + cos_kappa * sine
    forward, left, up = rho * c - t_x, rho * s - t_y, z - t_z
    elevation, _ = _around(
        forward * x_x + left * x_y + up * x_z, forward * z_x + left * z_y + up * z_z
    )
    yaw, rate = _around(x * c + y * s, y * c - x * s)
    return elevation, yaw, rate


@inlined
def _reading(elevation, yaw, rate, lines, beams, yaws, middles, n_beams):  # type: ignore[no-untyped-def]
    """Return the flat index of the reading at these entries of the tables, or -1; no branches."""
    beam = beams[int(elevation) & (CELLS - 1)]
    line = lines[int(yaw) & (CELLS - 1)]
    turn = yaws[max(line, 0) * n_beams + max(beam, 0)] - middles[max(line, 0)]
    line = lines[int(yaw - turn * rate + CELLS) & (CELLS - 1)]
    return line * n_beams + beam if (line >= 0) & (beam >= 0) else -1


@jit
def _branch(x, y, z, sign, lines, beams, yaws, middles, mount):  # type: ignore[no-untyped-def]
    """Return the flat index of the reading that sees a point, ahead (1) or behind (-1), or -1."""
    elevation, yaw, rate = _ways(x, y, z, sign, mount)
    n_beams = yaws.shape[1]
    return _reading(elevation, yaw, rate, lines, beams, yaws.reshape(-1), middles, n_beams)


@jit
def _scalars(mount):  # type: ignore[no-untyped-def]
    """Return the numbers of a mount, which loops over arrays would read anew for each point."""
    return (
        mount[0], mount[1], mount[2], mount[3], mount[4], mount[5], mount[6], mount[7], mount[8],
        mount[9], mount[10], mount[11], mount[12], mount[13],
    )  # fmt: skip


@jit
def lookup(projection, points, seen):  # type: ignore[no-untyped-def]
    """See ``projection.lookup``."""
    lines, beams, yaws, middles, mount, backwards = projection
    mount, found = _scalars(mount), np.empty(len(points), np.int64)
    for m in range(len(points)):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        found[m] = _branch(x, y, z, 1.0, lines, beams, yaws, middles, mount)
        if backwards and (found[m] < 0 or not seen[found[m]]):
            behind = _branch(x, y, z, -1.0, lines, beams, yaws, middles, mount)
            if behind >= 0 and seen[behind]:
                found[m] = behind
    return found


@twin_of(point_to_plane.normal_equations)
def normal_equations(target, sample, T, scale, gate, both, entries):  # type: ignore[no-untyped-def]
    """See ``point_to_plane.normal_equations``; the loops over a chunk run in wide registers."""
    table, target_yaws, row_of, (lines, beams, yaws, middles, mount, backwards) = target
    rows, source_yaws, source_lines, stride = sample
    jittery, area = both.jitter > 0 or both.target_jitter > 0, float(stride * stride)
    size = len(entries) + 1
    H, lost, faked = np.zeros((size, size)), np.zeros((size, size)), np.zeros((6, 6))
    b, h, line, square, pairs = np.zeros(size), np.zeros(size + 2), -1, 0.0, 0
    ways, at, met = np.empty((3, CHUNK)), np.empty(CHUNK, np.int64), np.empty((2, CHUNK), np.int64)
    work, scalars = np.empty((COLUMNS, CHUNK)), _scalars(mount)
    for first in range(0, len(rows), CHUNK):
        chunk, own_yaws = rows[first : first + CHUNK], source_yaws[first : first + CHUNK]
        _look(chunk.reshape(-1), len(chunk), T, scalars, ways)
        _read(ways, len(chunk), row_of, lines, beams, yaws.reshape(-1), middles, yaws.shape[1], at)
        if backwards:
            _look_back(chunk, T, row_of, lines, beams, yaws, middles, scalars, at)
        n = _meet(at, len(chunk), met)
        _gather(chunk, own_yaws, table, target_yaws, met, n, work.reshape(-1))
        found, off = _residuals(n, T, scale, gate, both, area, work.reshape(-1))
        pairs += found
        square += off
        if jittery:
            lines_of = source_lines[first : first + CHUNK]
            line = _add_lines(work, n, met[0], lines_of, line, entries, area, lost, b, h)
        _add(work, n, entries, H, b, faked)
    _take_line(lost, b, h, area)
    return Equations(
        _mirrored(H), _mirrored(lost), b, block(_mirrored(faked), entries), pairs, square
    )  # fmt: skip


@jit
def _look(rows, n, T, mount, ways):  # type: ignore[no-untyped-def]
    """Write under which ``ways`` (3, n) surfels ``rows`` (8 n) moved by ``T`` are seen ahead."""
    t_x, t_y, t_z = T[0, 3], T[1, 3], T[2, 3]
    xx, xy, xz, yx, yy, yz, zx, zy, zz = (
        T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2],
    )  # fmt: skip
    for m in range(n):
        x, y, z = rows[8 * m], rows[8 * m + 1], rows[8 * m + 2]
        ways[0, m], ways[1, m], ways[2, m] = _ways(
            xx * x + xy * y + xz * z + t_x, yx * x + yy * y + yz * z + t_y,
            zx * x + zy * y + zz * z + t_z, 1.0, mount,
        )  # fmt: skip


@jit
def _read(ways, n, row_of, lines, beams, yaws, middles, n_beams, at):  # type: ignore[no-untyped-def]
    """Write the target's surfels under ``ways`` (3, n) to ``at`` (n,), -1 where there is none."""
    for m in range(n):
        reading = _reading(ways[0, m], ways[1, m], ways[2, m], lines, beams, yaws, middles, n_beams)
        row = row_of[max(reading, 0)]
        at[m] = row if reading >= 0 else -1


@jit
def _look_back(rows, T, row_of, lines, beams, yaws, middles, mount, at):  # type: ignore[no-untyped-def]
    """Write to ``at`` (n,) what is seen behind where nothing is ahead."""
    for m in range(len(rows)):
        if at[m] >= 0:
            continue
        sx, sy, sz = rows[m, 0], rows[m, 1], rows[m, 2]
        x = T[0, 0] * sx + T[0, 1] * sy + T[0, 2] * sz + T[0, 3]
        y = T[1, 0] * sx + T[1, 1] * sy + T[1, 2] * sz + T[1, 3]
        z = T[2, 0] * sx + T[2, 1] * sy + T[2, 2] * sz + T[2, 3]
        reading = _branch(x, y, z, -1.0, lines, beams, yaws, middles, mount)
        if reading >= 0:
            at[m] = row_of[reading]


@jit
def _meet(at, n, met):  # type: ignore[no-untyped-def]
    """Write the pairs (2, k), source then target, of ``at`` (n,); return how many there are."""
    k = 0
    for m in range(n):
        met[0, k], met[1, k] = m, at[m]
        k += at[m] >= 0
    return k


@jit
def _gather(rows, source_yaws, table, yaws, met, n, w):  # type: ignore[no-untyped-def]
    """Write both surfels (8 each) and both yaws of ``n`` pairs to the columns of ``w``."""
    for k in range(n):
        i, j = met[0, k], met[1, k]
        for c in range(8):
            w[(SOURCE + c) * CHUNK + k], w[(TARGET + c) * CHUNK + k] = rows[i, c], table[j, c]
        w[YAWS * CHUNK + k], w[(YAWS + 1) * CHUNK + k] = source_yaws[i], yaws[j]


@jit
def _residuals(n, T, scale, gate, both, area, w):  # type: ignore[no-untyped-def]
    """Write derivatives, residuals and weights of ``n`` pairs to the columns of ``w``.

    The weight is 0 where a pair does not count. Returns how many do, and the sum of their squares.
    """
    jitter, target_jitter, density, share, tilt = both
    distance, c2 = gate.distance, gate.robust * gate.robust
    farthest, pairs, square = (MOST_ALONG_RAY * distance) ** 2, 0.0, 0.0
    t_x, t_y, t_z = T[0, 3], T[1, 3], T[2, 3]
    xx, xy, xz, yx, yy, yz, zx, zy, zz = (
        T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2],
    )  # fmt: skip
    for k in range(n):
        s, t = SOURCE * CHUNK + k, TARGET * CHUNK + k
        px, py, pz = w[s], w[s + CHUNK], w[s + 2 * CHUNK]
        ax, ay = xx * px + xy * py + xz * pz, yx * px + yy * py + yz * pz
        az = zx * px + zy * py + zz * pz
        px, py, pz = w[s + 3 * CHUNK], w[s + 4 * CHUNK], w[s + 5 * CHUNK]
        nx, ny = xx * px + xy * py + xz * pz, yx * px + yy * py + yz * pz
        nz = zx * px + zy * py + zz * pz
        qx, qy, qz = w[t], w[t + CHUNK], w[t + 2 * CHUNK]
        px, py, pz = w[t + 3 * CHUNK], w[t + 4 * CHUNK], w[t + 5 * CHUNK]
        cosine = nx * px + ny * py + nz * pz
        nx, ny, nz = nx + px, ny + py, nz + pz
        norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-18)
        nx, ny, nz = nx * norm, ny * norm, nz * norm
        ux, uy, uz = ax + t_x - qx, ay + t_y - qy, az + t_z - qz
        swing, turn = ny * ax - nx * ay, ny * qx - nx * qy
        g = w[YAWS * CHUNK + k] * swing - w[(YAWS + 1) * CHUNK + k] * turn
        e = nx * ux + ny * uy + nz * uz + g * scale
        variance = w[s + 6 * CHUNK] + w[t + 6 * CHUNK]
        lines = _lines_per_line(nx, ny, ax, ay, qx, qy, density)
        own = math.sqrt(jitter * swing * swing + target_jitter * lines * turn * turn)
        robust = c2 / (c2 + e * e / (variance + own * own))
        good = (cosine > MIN_NORMAL_COSINE) & (abs(e) < distance)
        good &= ux * ux + uy * uy + uz * uz < farthest
        counts = 1.0 if good else 0.0
        weight = counts * share * area / variance * robust * robust
        pairs += counts
        square += counts * e * e
        j = DERIVATIVES * CHUNK + k
        w[j], w[j + CHUNK], w[j + 2 * CHUNK] = nx, ny, nz
        w[j + 3 * CHUNK], w[j + 4 * CHUNK] = ay * nz - az * ny, az * nx - ax * nz
        w[j + 5 * CHUNK], w[j + 6 * CHUNK] = swing, g
        w[E * CHUNK + k], w[WEIGHT * CHUNK + k] = e, weight
        w[NU * CHUNK + k] = weight * ((w[s + 7 * CHUNK] + w[t + 7 * CHUNK]) / 4 + tilt)
        w[A * CHUNK + k], w[(A + 1) * CHUNK + k], w[(A + 2) * CHUNK + k] = ax, ay, az
        w[OWN * CHUNK + k] = math.copysign(own, swing)
    return int(pairs), square


@jit
def _add_lines(w, n, met, lines, line, entries, area, lost, b, h):  # type: ignore[no-untyped-def]
    """Add to the sums of a line in ``h`` and take the lines before from ``b``; return the line."""
    size = len(b)
    for m in range(n):
        if w[WEIGHT, m] == 0.0:
            continue
        if lines[met[m]] != line:
            _take_line(lost, b, h, area)
            line = lines[met[m]]
        weighted = w[WEIGHT, m] * w[OWN, m]
        for i in range(size - 1):
            h[i] += weighted * w[DERIVATIVES + entries[i], m]
        h[size - 1] += weighted * w[DERIVATIVES + 6, m]
        h[size] += weighted * w[E, m]
        h[size + 1] += weighted * w[OWN, m]
    return line


@jit
def _dot(a, b, c, n):  # type: ignore[no-untyped-def]
    """Return the sum of a b c over arrays (n,)."""
    total = 0.0
    for m in range(n):
        total += a[m] * b[m] * c[m]
    return total


@jit
def _add(w, n, entries, H, b, faked):  # type: ignore[no-untyped-def]
    """Add ``n`` pairs to the lower triangles of the sums."""
    size, J, e, weight, nu = len(b), w[DERIVATIVES:], w[E], w[WEIGHT], w[NU]
    for i in range(size):
        column = J[entries[i]] if i < size - 1 else J[6]
        b[i] += _dot(column, weight, e, n)
        for k in range(i + 1):
            H[i, k] += _dot(column, weight, J[entries[k]] if k < size - 1 else J[6], n)
    for i in entries:
        for k in entries:
            if k <= i:
                faked[i, k] -= _dot(J[i], nu, J[k], n)
    first, second = np.empty(3), np.empty((3, 3))
    for i in range(3):
        first[i] = np.sum(nu[:n] * w[A + i, :n])
        for k in range(i + 1):
            second[i, k] = _dot(w[A + i], nu, w[A + k], n)
    _add_swung(faked, np.sum(nu[:n]), first, second)


@inlined
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
    table, _, row_of, (lines, beams, yaws, middles, mount, backwards) = target
    mount, cost, seen = _scalars(mount), 0.0, 0
    for m in range(len(rows)):
        sx, sy, sz = rows[m, 0], rows[m, 1], rows[m, 2]
        x = T[0, 0] * sx + T[0, 1] * sy + T[0, 2] * sz + T[0, 3]
        y = T[1, 0] * sx + T[1, 1] * sy + T[1, 2] * sz + T[1, 3]
        z = T[2, 0] * sx + T[2, 1] * sy + T[2, 2] * sz + T[2, 3]
        at = _branch(x, y, z, 1.0, lines, beams, yaws, middles, mount)
        if at < 0 or known[at] == UNKNOWN:
            at = _branch(x, y, z, -1.0, lines, beams, yaws, middles, mount) if backwards else -1
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
