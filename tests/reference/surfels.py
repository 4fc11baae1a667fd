"""Surfels of a range image: the plane behind the noise at every reading.

A plane m . P = 1 seen along the beam P = o + r d, with o the lidar's place on its circle about the
yaw axis and P taken from the height of the lidar, obeys, with the inverse range q = 1 / r,

    q = m . x,    x = P / r = d + q o,

which is linear in m, and in which the noise of q is the same over a small window. So the least
squares m = A^-1 b, A = sum x x^T, b = sum x q, has no bias towards the rays, unlike a plane through
the points (Badino et al., ICRA 2011, for o = 0). All sums over windows come from one summed-area
table of 11 moments. Of several windows the largest counts over which the plane fits:

    rss <= s^2 (n - 3) (1 + 0.7 sqrt(2 / (n - 3))),  s = q |m| sigma_n,   sigma_n = |n . d| sigma_r,

with n = m / |m|, and near whose middle the reading lies, if it is seen flatter than 60 deg.
Where the yaw of each line errs by sigma_psi besides, its readings in the window of L lines move
together along the normal, by l = n . (z x P) per radian, which adds up to

    n q^2 |m|^2 l^2 sigma_psi^2 (1 + 0.7 sqrt(2 / L)).

The noise of the normal is that of m: cov(n) = v / |m|^2 (I - n n^T) A^-1 (I - n n^T), of which the
mean variance over the two tangents is kept. With c the factor on the variance of a mean of readings
correlated along a line, and all n / L readings of a line moved together by its yaw error,

    v = c s^2 + (n / L) q^2 |m|^2 l^2 sigma_psi^2.

Inside of a curved surface the plane lies too deep. The readings of the next smaller window lie on
(1 + a) m, a = sum q m . x / sum (m . x)^2 - 1, and of a paraboloid the middle is farther off by the
gain g = 1 / (1 - w), w the mean ratio of both windows' variances along lines and beams. Of a only
what exceeds its noise counts, the share 1 - var(a) / a^2, and the surfel lies on the plane
(1 + g a share) m:

    var(a) = c s^2 (1 / sum_inner (m . x)^2 - 1 / sum (m . x)^2) + l^2 |m|^2 sigma_psi^2
             (1 / L_inner - 1 / L).
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, SmallIntArray

FILLED = 0.6
"""A window counts when this share of its readings is there."""
TOLERANCE = 0.7
"""Largest residual sum of squares of a fit, in sigma above that of noise alone."""
MOST_TILT = 0.25
"""Standard deviation of a normal [rad] from which on it tells nothing."""
LIMB_COSINE = 0.5
"""Cosine of incidence (60 deg) up to which a reading may lie anywhere in its window."""
MOST_OFF_CENTRE = 1.01
"""Squared distance of a reading from its window's middle, in variances of the window along it."""
MIN_COSINE = 0.05
"""Flatter than this (87 deg from the normal) no plane is believed."""
X, N, VARIANCE, NORMAL_VARIANCE = np.s_[0:3], np.s_[3:6], 6, 7
"""Columns of a surfel: its point on the central beam [m], its unit normal towards the lidar, the
variance of one reading along the normal by range noise [m2], that of the normal [rad2]."""
MOMENTS = 11
"""Channels of the summed-area table: x x^T (6), x q (3), q^2, 1."""
AT_ONCE = 12
"""Lines that are fitted at once: some 8 MB, for robots with little memory."""
UNKNOWN, EMPTY, SURFACE = 0, 1, 2
"""What a reading says of its ray."""
HOLE = 2
"""A ray is empty if no reading this near returned; single ones are dropouts."""


def fit_surfels(
    ranges: FloatArray,
    yaws: FloatArray,
    beams: FloatArray,
    lever: FloatArray,
    valid: BoolArray,
    keep: BoolArray,
    noise: FloatArray,
    windows: IntArray,
) -> tuple[FloatArray, FloatArray, SmallIntArray]:
    """Return the surfels; the method is at the module's head.

    Args:
        ranges: (n_lines, n_beams) [m].
        yaws: Of the base at each beam (n_lines, n_beams) [rad].
        beams: Directions in ``base`` (n_beams, 3).
        lever: Place of the lidar in ``base`` (3,) [m].
        valid: Readings that count (n_lines, n_beams).
        keep: Readings that get a surfel (n_lines, n_beams).
        noise: Range sigma at 0 [m], its growth per metre, the sigma of a line's yaw [rad] and the
            factor for correlated beams (4,).
        windows: Half sizes in lines and beams, largest first (k, 2).

    Returns:
        Rows (m, 8), columns as above, line by line; the yaw at which each was measured (m,) [rad];
        and the row of each reading (n_lines, n_beams), -1 where no plane fits.
    """
    margin, n = int(windows[:, 0].max()), 0
    index, found = np.full(ranges.shape, -1, dtype=np.int32), []
    for first in range(0, len(ranges), AT_ONCE):
        inner = slice(first, first + AT_ONCE)
        outer = slice(max(0, first - margin), first + AT_ONCE + margin)
        wanted = np.zeros_like(keep[outer])
        wanted[first - outer.start :][:AT_ONCE] = keep[inner]
        block = _fit_lines(
            ranges[outer], yaws[outer], beams, lever, valid[outer], wanted, noise, windows
        )[first - outer.start :][:AT_ONCE]
        fits = block[..., VARIANCE] > 0
        found.append(block[fits])
        index[inner][fits] = n + np.arange(len(found[-1]))
        n += len(found[-1])
    return np.concatenate(found), yaws[index >= 0], index


def _fit_lines(
    ranges: FloatArray,
    yaws: FloatArray,
    beams: FloatArray,
    lever: FloatArray,
    valid: BoolArray,
    keep: BoolArray,
    noise: FloatArray,
    windows: IntArray,
) -> FloatArray:
    """Return the table of surfels of some lines, from those lines alone."""
    o, d = _turned(lever * (1.0, 1.0, 0.0), yaws), _turned(beams, yaws)
    q = np.divide(1.0, ranges, out=np.zeros_like(ranges), where=valid)
    sums = _summed_area(d + q[..., None] * o, q, valid)
    table = np.zeros((*ranges.shape, 8))
    line, beam = np.nonzero(keep)
    for half, inner in zip(windows, (*windows[1:], windows[-1]), strict=True):
        total, lines, area = _box_sums(sums, line, beam, half)
        at = (o[line, beam], d[line, beam], q[line, beam])
        rows, fits = _planes(total, lines, area, *at, noise)
        if np.any(inner < half):
            near, near_lines, _ = _box_sums(sums, line, beam, inner)
            gain = 1.0 / (1.0 - np.mean(inner * (inner + 1) / (half * (half + 1))))
            rows = _on_surface(rows, total, lines, near, near_lines, gain, *at[1:], noise)
        rows[:, 2] += lever[2]
        table[line[fits], beam[fits]] = rows[fits]
        line, beam = line[~fits], beam[~fits]
    return table


def _turned(vectors: FloatArray, yaws: FloatArray) -> FloatArray:
    """Return ``vectors`` (..., 3) in ``base`` as they lie in ``scan`` (n_lines, n_beams, 3)."""
    c, s = np.cos(yaws), np.sin(yaws)
    x, y, z = (np.broadcast_to(vectors[..., i], yaws.shape) for i in range(3))
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _summed_area(x: FloatArray, q: FloatArray, valid: BoolArray) -> FloatArray:
    """Return the summed-area table (n_lines + 1, n_beams + 1, 11) of the moments."""
    sums = np.zeros((x.shape[0] + 1, x.shape[1] + 1, MOMENTS))
    x, inner = x * valid[..., None], sums[1:, 1:]
    for channel, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        inner[..., channel] = x[..., i] * x[..., j]
    inner[..., 6:9] = x * q[..., None]
    inner[..., 9] = q * q
    inner[..., 10] = valid
    np.cumsum(inner, axis=0, out=inner)
    np.cumsum(inner, axis=1, out=inner)
    return sums


def _box_sums(
    sums: FloatArray, line: IntArray, beam: IntArray, half: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the moments (n, 11), lines (n,) and area (n,) of the windows around readings."""
    low_line, high_line = (
        np.maximum(line - half[0], 0),
        np.minimum(line + half[0] + 1, len(sums) - 1),
    )
    low_beam = np.maximum(beam - half[1], 0)
    high_beam = np.minimum(beam + half[1] + 1, sums.shape[1] - 1)
    total = sums[high_line, high_beam] - sums[low_line, high_beam]
    total -= sums[high_line, low_beam] - sums[low_line, low_beam]
    lines = (high_line - low_line).astype(np.float64)
    return total, lines, lines * (high_beam - low_beam)


def _planes(
    total: FloatArray,
    lines: FloatArray,
    area: FloatArray,
    o: FloatArray,
    d: FloatArray,
    q: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Return the surfels (n, 8) of windows with moments ``total`` (n, 11), and which fit."""
    xx, xy, xz, yy, yz, zz, bx, by, bz, qq, n = total.T
    cofactors = (
        yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
        xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy,
    )  # fmt: skip
    with np.errstate(divide="ignore", invalid="ignore"):
        det = xx * cofactors[0] + xy * cofactors[1] + xz * cofactors[2]
        i_xx, i_xy, i_xz, i_yy, i_yz, i_zz = (c / det for c in cofactors)
        mx, my, mz = (
            i_xx * bx + i_xy * by + i_xz * bz,
            i_xy * bx + i_yy * by + i_yz * bz,
            i_xz * bx + i_yz * by + i_zz * bz,
        )
        m = np.stack([mx, my, mz], axis=1)
        square = np.sum(m * m, axis=1)
        along = np.sum(m * d, axis=1)
        r = (1.0 - np.sum(m * o, axis=1)) / along
        points = o + r[:, None] * d
        by_range = (along * (noise[0] + noise[1] / q)) ** 2
        scatter = q * q * by_range
        rss = qq - mx * bx - my * by - mz * bz
        by_yaw = q * (my * points[:, 0] - mx * points[:, 1]) * noise[2]
        by_yaw = n * by_yaw * by_yaw
        most = by_yaw * (1 + TOLERANCE * np.sqrt(2 / lines))
        most += scatter * (n - 3) * (1 + TOLERANCE * np.sqrt(2 / (n - 3)))
        trace = i_xx + i_yy + i_zz
        normal_part = mx * (i_xx * mx + 2 * (i_xy * my + i_xz * mz)) + my * (
            i_yy * my + 2 * i_yz * mz
        )
        tangents = trace - (normal_part + i_zz * mz * mz) / square
        fits = (n >= FILLED * area) & (n > 5) & (det > 1e-12 * _trace_cubed(xx, yy, zz))
        fits &= (along * along > MIN_COSINE**2 * square) & (r > 0)
        fits &= rss <= most
        fits &= (along * along > LIMB_COSINE**2 * square) | _central(total, points)
        normals = -np.sign(along)[:, None] * m / np.sqrt(square)[:, None]
        of_normal = tangents * (scatter * noise[3] + by_yaw / lines) / (2 * square)
        fits &= of_normal < MOST_TILT**2
        rest = np.stack([by_range / square, of_normal], axis=1)
    return np.concatenate([points, normals, rest], axis=1), fits


def _on_surface(
    rows: FloatArray,
    total: FloatArray,
    lines: FloatArray,
    near: FloatArray,
    near_lines: FloatArray,
    gain: float,
    d: FloatArray,
    q: FloatArray,
    noise: FloatArray,
) -> FloatArray:
    """Return surfels (n, 8) moved along their rays onto a curved surface.

    ``total`` and ``near`` are the moments (n, 11) of their windows and of those inside.
    """
    rows, n = rows.copy(), rows[:, N]
    xx, xy, xz, yy, yz, zz, *b, _, _ = near.T
    A = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.sum(n * rows[:, X], axis=1)
        of_near = np.einsum("ni,nij,nj->n", n, A, n)
        off = distance * np.sum(n * np.stack(b, axis=1), axis=1) / of_near - 1.0
        of_all = distance * np.sum(n * total[:, 6:9], axis=1)
        swing = (n[:, 1] * rows[:, 0] - n[:, 0] * rows[:, 1]) / distance
        by_reading = q * q * rows[:, VARIANCE] * noise[3] * (1 / of_near - 1 / of_all)
        by_line = swing**2 * noise[2] ** 2 * (1 / near_lines - 1 / lines)
        share = np.maximum(0.0, 1.0 - (by_reading + by_line) / off**2)
        farther = distance * (1.0 / (1.0 + gain * share * off) - 1.0) / np.sum(n * d, axis=1)
        rows[:, X] += farther[:, None] * d
    return rows


def _central(total: FloatArray, points: FloatArray) -> BoolArray:
    """Return whether ``points`` (n, 3) lie near the middle of windows with moments (n, 11).

    The window's points count by q^2; the limit is in variances along the way to their middle.
    """
    xx, xy, xz, yy, yz, zz, *b, qq, _ = total.T
    middle = np.stack(b, axis=1) / qq[:, None]
    A = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3) / qq[:, None, None]
    way = middle - points
    variance = np.einsum("ni,nij,nj->n", way, A, way) - np.sum(way * middle, axis=1) ** 2
    central: BoolArray = np.sum(way * way, axis=1) ** 2 <= MOST_OFF_CENTRE * variance
    return central


def _trace_cubed(xx: FloatArray, yy: FloatArray, zz: FloatArray) -> FloatArray:
    """Return the scale of a determinant with this diagonal, to recognise a singular one."""
    return (xx + yy + zz) ** 3


def knowledge(index: SmallIntArray, valid: BoolArray) -> SmallIntArray:
    """Return what each reading says of its ray (n_lines * n_beams,)."""
    wide = np.pad(valid, HOLE)
    size = 2 * HOLE + 1
    near = np.any(np.lib.stride_tricks.sliding_window_view(wide, (size, size)), axis=(2, 3))
    known = np.where(near, UNKNOWN, EMPTY).astype(np.int32)
    known[index >= 0] = SURFACE
    return known.reshape(-1)
