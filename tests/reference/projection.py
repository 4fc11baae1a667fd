"""Projection of a point onto the line and beam of a yawing scanner that see it, in NumPy.

The scan plane at yaw psi has the normal Rz(psi) k, k = R_base_lidar e_y, and contains the lidar at
Rz(psi) t. A point at azimuth phi and distance rho from the yaw axis lies in it where

    k . Rz(-psi) p = k . t   <=>   phi - psi = kappa + beta  or  kappa + pi - beta,
    sin(beta) = (k . t - k_z z) / (a rho),

with a and kappa + pi / 2 the length and azimuth of k in the plane of the floor. The first solution
is seen ahead of the axis, the second over the zenith behind it. In the scan plane the elevation
follows from the point relative to the lidar. Tables then give the nearest line and beam.

No angle is computed: a direction (c, s) is looked up by how far round the square |c| + |s| = 1 it
lies, which grows with its angle, by (c^2 + s^2) / (|c| + |s|)^2 per radian.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    SmallIntArray,
    read_only,
)

CELLS = 16384
"""Entries of the tables over a full turn: 0.016 to 0.031 deg each."""
QUARTER = CELLS / 4
REACH = 0.75
"""A direction belongs to the nearest line or beam within this many spacings."""


class Projection(NamedTuple):
    """Tables and mount of one sweep.

    Attributes:
        lines: Line by yaw of its middle beam (CELLS,); -1 where there is none.
        beams: Beam by elevation (CELLS,); -1 where there is none.
        yaws: Of each beam (n_lines, n_beams) [rad].
        middles: Yaw of each line's middle beam (n_lines,) [rad]; a line takes a tenth of a second,
            so that the others are near.
        mount: cos kappa, sin kappa, a, k . t, k_z, then t (3), x axis (3), z axis (3) of the lidar
            in ``base`` (14,).
        backwards: Whether any beam looks back over the zenith or the nadir.
    """

    lines: SmallIntArray
    beams: SmallIntArray
    yaws: FloatArray
    middles: FloatArray
    mount: FloatArray
    backwards: bool


def lookup(projection: Projection, points: FloatArray, seen: BoolArray) -> IntArray:
    """Return the flat index of the reading (m,) that sees each of ``points`` (m, 3), or -1."""
    found = _branch(projection, points, ahead=True)
    if not projection.backwards:
        return found
    missing = np.flatnonzero((found < 0) | ~seen[found])
    behind = _branch(projection, points[missing], ahead=False)
    better = (behind >= 0) & seen[behind]
    found[missing[better]] = behind[better]
    return found


def _branch(projection: Projection, points: FloatArray, *, ahead: bool) -> IntArray:
    lines, beams, yaws, middles, mount, _ = projection
    cos_kappa, sin_kappa, a, k_t, k_z = mount[:5]
    t, x_axis, z_axis = mount[5:8], mount[8:11], mount[11:14]
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    rho = np.maximum(np.sqrt(x * x + y * y), 1e-9)
    sine = np.clip((k_t - k_z * z) / (a * rho), -1.0, 1.0)
    cosine = np.sqrt(1.0 - sine * sine)
    if not ahead:
        cosine = -cosine
    c, s = cos_kappa * cosine - sin_kappa * sine, sin_kappa * cosine + cos_kappa * sine
    forward, left, up = rho * c - t[0], rho * s - t[1], z - t[2]
    elevation, _ = around(
        forward * x_axis[0] + left * x_axis[1] + up * x_axis[2],
        forward * z_axis[0] + left * z_axis[1] + up * z_axis[2],
    )
    beam = beams[_cells(elevation)]
    yaw, rate = around(x * c + y * s, y * c - x * s)
    line = lines[_cells(yaw)]
    line = lines[_cells(yaw - (yaws[line, beam] - middles[line]) * rate)]
    found = line * yaws.shape[1] + beam
    return np.where((line >= 0) & (beam >= 0), found, -1)


def around(c: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pseudo-angle of directions (c, s), and its growth per radian.

    Both in entries of the tables; 0 to CELLS around.
    """
    shrunk = 1.0 / (np.abs(c) + np.abs(s) + 1e-9)
    way = s * shrunk  # -1 to 1 within a half turn
    way = np.where(c < 0, 2.0 - way, np.where(s < 0, 4.0 + way, way))
    return QUARTER * way, QUARTER * (c * c + s * s) * shrunk * shrunk


def _cells(way: FloatArray) -> IntArray:
    return (way + CELLS).astype(np.int64) % CELLS


def nearest(angles: FloatArray, spacing: float, centres: FloatArray) -> SmallIntArray:
    """Return the index of the nearest of ``angles`` (n,) [rad] for each cell, -1 beyond reach.

    Args:
        angles: They may lie anywhere around the turn.
        spacing: Of two of them, typically [rad].
        centres: Angles in the middle of the cells, ascending (CELLS,) [rad].
    """
    n, folded = len(angles), np.mod(angles, math.tau)
    index, around = np.empty(n + 2, dtype=np.int64), np.empty(n + 2)
    index[1:-1] = np.argsort(folded, kind="mergesort")
    index[0], index[n + 1] = index[n], index[1]
    around[1:-1] = folded[index[1:-1]]
    around[0], around[n + 1] = around[n] - math.tau, around[1] + math.tau
    middles = (around[1:] + around[:-1]) / 2
    reach = max(REACH * spacing, math.tau / CELLS)
    low, high = around - reach, around + reach
    low[1:], high[:-1] = np.maximum(low[1:], middles), np.minimum(high[:-1], middles)
    first, end = np.searchsorted(centres, low), np.searchsorted(centres, high)
    table = np.full(CELLS, -1, dtype=np.int32)
    for k in range(n + 2):
        table[first[k] : end[k]] = index[k]
    return table


@cache
def _centres() -> FloatArray:
    """Return the angles in the middle of the tables' entries (CELLS,) [rad]."""
    around = (np.arange(CELLS) + 0.5) * (4.0 / CELLS)
    quarter, share = np.divmod(around, 1.0)
    return read_only(quarter * (math.pi / 2) + np.arctan2(share, 1.0 - share))
