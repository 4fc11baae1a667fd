"""Vertical edges where a surface ends: features that constrain a slide along a flat face.

Where a line sees a surface and the next one something farther, or several nothing, the surface
ends between the two. A run of beams that all jump there is one vertical edge, measured once: its
yaw is known to a line spacing, so across the ray its variance is (r dyaw)^2 / 12 + (r sigma_yaw)^2.
The surface must be seen steeply enough: a curved body's outline has no place of its own and wanders
with the viewpoint.
"""

from __future__ import annotations

import numpy as np

from reference.surfels import N, X
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    SmallIntArray,
)

JUMP = 0.10
"""Least step in range at an edge [m]; several sigma, and more than a steep face within a line."""
MIN_BEAMS = 8
"""Least number of adjacent beams in an edge."""
MIN_HEIGHT = 0.05
"""Least height of an edge [m]."""
MIN_COSINE = 0.35
"""A surface seen flatter at its edge (70 deg from the normal) may be turning away."""
MIN_FLAT = 0.9
"""Least length of a normal in the top view: a surface leaning more (26 deg) has no upright end."""
MOST_SPREAD = 0.01
"""A run whose points scatter more about its mean in the top view is no vertical edge [m]."""
UNEVEN = 0.25
OFF_PLANE = 0.03
"""The last reading must lie on the plane that ends [m]: 3 sigma. A face that turns away behind it
and is seen so flat that its own readings jump is not where the plane ends."""
EMPTY = 3
"""Lines without return that count as empty space; single ones are dropouts."""
FLAT, BEND = 4, 0.12
"""Lines farther in, where normals of a flat face agree, and the tangent of their difference."""
INWARDS = 2
"""Lines from the edge to the surfel that carries it: nearer windows would cross the edge."""


def edge_rows(
    ranges: FloatArray,
    yaws: FloatArray,
    beams: FloatArray,
    lever: FloatArray,
    rows: FloatArray,
    index: SmallIntArray,
    valid: BoolArray,
    yaw_sigma: float,
) -> FloatArray:
    """Return the edges as place, across, variance, side and heights (n, 8).

    Args:
        ranges: (n_lines, n_beams) [m].
        yaws: Of the base at each beam (n_lines, n_beams) [rad].
        beams: Directions in ``base`` (n_beams, 3), or (n_lines, n_beams, 3).
        lever: Place of the lidar in ``base`` (3,) [m].
        rows: Surfels (m, 8).
        index: Row of each reading (n_lines, n_beams), or -1.
        valid: Readings that are distances (n_lines, n_beams).
        yaw_sigma: Of a line [rad].
    """
    found = []
    for side in (1, -1):
        for line, first, end in _runs(_jumps(ranges, index >= 0, valid, side)):
            near = line if side > 0 else line + 1
            part = (near, slice(first, end))
            rays = beams if beams.ndim == 2 else beams[near]
            x, y, z = (lever + ranges[part][:, None] * rays[first:end]).T
            c, s = np.cos(yaws[part]), np.sin(yaws[part])
            last = np.stack([c * x - s * y, s * x + c * y, z], axis=1)
            carrier = index[line - INWARDS if side > 0 else line + 1 + INWARDS, first:end]
            inner = near - side * (INWARDS + FLAT)
            if not 0 <= inner < len(index) or not _flat(rows, carrier, index[inner, first:end]):
                continue
            found.append(_run(yaws, last, rows[carrier], yaw_sigma, (line, first, end), side))
    edges = [edge for edge in found if edge is not None]
    return np.array(edges).reshape(-1, 8)


def _flat(rows: FloatArray, carrier: SmallIntArray, inner: SmallIntArray) -> bool:
    """Return whether the normals of a run agree with those farther in."""
    both = (carrier >= 0) & (inner >= 0)
    if 2 * np.count_nonzero(both) < len(both):
        return False
    a, b = rows[carrier[both], 3:5].sum(axis=0), rows[inner[both], 3:5].sum(axis=0)
    return bool(abs(a[0] * b[1] - a[1] * b[0]) < BEND * (a @ b))


def _jumps(ranges: FloatArray, surfel: BoolArray, valid: BoolArray, side: int) -> BoolArray:
    """Return whether a surface ends between lines i and i + 1 (n_lines - 1, n_beams).

    For ``side`` 1 it lies on line i, for -1 on line i + 1. Beyond it the next reading is farther,
    or ``EMPTY`` lines return nothing.
    """
    if side < 0:
        return _jumps(ranges[::-1], surfel[::-1], valid[::-1], 1)[::-1]
    with np.errstate(invalid="ignore"):
        farther = (ranges[1:] - ranges[:-1] > JUMP) & valid[1:]
    empty = ~valid[1:]
    for k in range(1, EMPTY):
        empty[:-k] &= ~valid[1 + k :]
        empty[-k:] = False
    carried = np.zeros_like(empty)
    carried[INWARDS:] = surfel[: -1 - INWARDS]
    return np.asarray((farther | empty) & carried & valid[:-1])


def _runs(jumps: BoolArray) -> list[tuple[int, int, int]]:
    """Return line, first beam and end of each run of at least ``MIN_BEAMS`` jumps."""
    rows = np.flatnonzero(np.count_nonzero(jumps, axis=1) >= MIN_BEAMS)
    padded = np.zeros((len(rows), jumps.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = jumps[rows]
    steps = np.diff(padded, axis=1)
    line, first = np.nonzero(steps == 1)
    _, end = np.nonzero(steps == -1)
    long = end - first >= MIN_BEAMS
    return list(
        zip(rows[line[long]].tolist(), first[long].tolist(), end[long].tolist(), strict=True)
    )


def _spacing(yaws: FloatArray, line: int, beam: int) -> float:
    """Return the angle between two lines, that of the first two where lines are evenly spaced.

    Two that see the same place count as half the mean spacing apart.
    """
    usual = float(np.mean(np.abs(yaws[1] - yaws[0])))
    step = float(abs(yaws[line + 1, beam] - yaws[line, beam]))
    if abs(step - usual) <= UNEVEN * usual:
        return usual
    return max(step, float(abs(yaws[-1, beam] - yaws[0, beam])) / (2 * (len(yaws) - 1)))


def _run(
    yaws: FloatArray,
    last: FloatArray,
    rows: FloatArray,
    yaw_sigma: float,
    run: tuple[int, int, int],
    side: int,
) -> FloatArray | None:
    """Return a run as place, across, variance, side and heights (8,); None if it is no edge.

    ``last`` are the points (m, 3) of the run's beams on the surface's last line, ``rows`` the
    surfels (m, 8) that carry it.
    """
    line, first, end = run
    beams = slice(first, end)
    off = np.abs(np.sum(rows[:, N] * (last - rows[:, X]), axis=1))
    both = yaws[line : line + 2, beams]
    middle = both.mean(axis=0)
    ray = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    n = rows[:, N]
    flat = np.sqrt(n[:, 0] ** 2 + n[:, 1] ** 2)
    incidence = -np.sum(n[:, :2] * ray, axis=1)
    upright = (incidence > MIN_COSINE) & (flat > MIN_FLAT) & (off < OFF_PLANE)
    heights = rows[upright, 2]
    if np.count_nonzero(upright) < MIN_BEAMS or np.ptp(heights) < MIN_HEIGHT:
        return None
    n, ray, rows = n[upright], ray[upright], rows[upright]
    reach = np.sum(n * rows[:, X], axis=1) - n[:, 2] * rows[:, 2]
    rho = reach / np.sum(n[:, :2] * ray, axis=1)
    places = rho[:, None] * ray
    place = places.mean(axis=0)
    if np.sqrt(np.mean(np.sum((places - place) ** 2, axis=1))) > MOST_SPREAD:
        return None
    spacing = _spacing(yaws, line, (first + end) // 2)
    distance = float(np.hypot(*place))
    variance = distance**2 * (spacing**2 / 12 + yaw_sigma**2)
    across = np.array([-place[1], place[0]]) / distance
    return np.array([*place, *across, variance, side, heights.min(), heights.max()])


def edge_sums(
    target: FloatArray, source: FloatArray, T: FloatArray, distance: float, robust: float
) -> tuple[FloatArray, FloatArray]:
    """Return information (6, 6) and gradient (6,) of the edges at ``T`` (4, 4).

    Each source edge is paired with the nearest target edge of its side at its height; the residual
    is their distance across the target's ray.

    Args:
        target: As rows (m, 8).
        source: As rows (n, 8).
        T: ``T_target_source``.
        distance: Farther edges are not paired [m].
        robust: c of the weights, in standard deviations.
    """
    if len(target) == 0 or len(source) == 0:
        return np.zeros((6, 6)), np.zeros(6)
    a = source[:, :2] @ T[:2, :2].T
    apart = (a + T[:2, 3])[:, None] - target[:, :2]
    far = np.hypot(apart[..., 0], apart[..., 1])
    low = np.maximum(source[:, None, 6], target[:, 6])
    high = np.minimum(source[:, None, 7], target[:, 7])
    far[(source[:, None, 5] != target[:, 5]) | (high <= low)] = np.inf
    pick = np.argmin(far, axis=1)
    chosen = np.flatnonzero(far[np.arange(len(a)), pick] < distance)
    pick, a = pick[chosen], a[chosen]
    n, c2 = target[pick, 2:4], robust * robust
    e = np.sum(n * apart[chosen, pick], axis=1)
    variance = source[chosen, 4] + target[pick, 4]
    w = (c2 / (c2 + e * e / variance)) ** 2 / variance
    J = np.zeros((len(e), 6))
    J[:, :2], J[:, 5] = n, n[:, 1] * a[:, 0] - n[:, 0] * a[:, 1]
    return (J * w[:, None]).T @ J, J.T @ (w * e)
