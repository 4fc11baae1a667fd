"""From a point back to the line and beam of a yawing scanner that see it, in closed form.

The scan plane at yaw psi has the normal Rz(psi) k, k = R_base_lidar e_y, and contains the lidar at
Rz(psi) t. A point at azimuth phi and distance rho from the yaw axis lies in it where

    k . Rz(-psi) p = k . t   <=>   phi - psi = kappa + beta  or  kappa + pi - beta,
    sin(beta) = (k . t - k_z z) / (a rho),

with a and kappa + pi / 2 the length and azimuth of k in the plane of the floor. The first solution
is seen ahead of the axis, the second over the zenith behind it. In the scan plane the elevation
follows from the point relative to the lidar. Tables then give the nearest line and beam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.registration.median import median
from scan3d_twin.core.types import FloatArray, IntArray, RangeImage

CELLS = 8192
"""Entries of the tables over a full turn: 0.04 deg each."""
REACH = 0.75
"""A direction belongs to the nearest line or beam within this many spacings."""


@dataclass(frozen=True)
class Projection:
    """Tables and mount of one sweep.

    Attributes:
        lines: Line by yaw of its middle beam (CELLS,); -1 where there is none.
        beams: Beam by elevation (CELLS,); -1 where there is none.
        offsets: Yaw of each beam relative to its line's middle beam (n_lines, n_beams) [rad].
        mount: cos kappa, sin kappa, kappa, a, k . t, k_z, then t (3), x axis (3), z axis (3) of
            the lidar in ``base`` (15,).
    """

    lines: IntArray
    beams: IntArray
    offsets: FloatArray
    mount: FloatArray

    @staticmethod
    def of(image: RangeImage) -> Projection:
        """Return the projection of a sweep."""
        middle = image.yaws[:, image.spec.n_beams // 2]
        R, t = image.T_base_lidar[:3, :3], image.T_base_lidar[:3, 3]
        k = R[:, 1]
        kappa = math.atan2(k[1], k[0]) - math.pi / 2
        a = max(math.hypot(k[0], k[1]), 1e-9)
        head = [math.cos(kappa), math.sin(kappa), kappa, a, float(k @ t), k[2]]
        return Projection(
            _table(middle),
            _table(image.spec.elevations),
            image.yaws - middle[:, None],
            np.concatenate([head, t, R[:, 0], R[:, 2]]),
        )

    def lookup(self, points: FloatArray, seen: FloatArray | IntArray) -> IntArray:
        """Return the flat index of the reading (m,) that sees each of ``points`` (m, 3), or -1.

        Of two readings the one ahead of the axis counts, unless ``seen`` is 0 there.

        Args:
            points: In ``scan`` [m].
            seen: (n_lines * n_beams,).
        """
        found = self._branch(points, ahead=True)
        missing = np.flatnonzero((found < 0) | (seen[found] == 0))
        behind = self._branch(points[missing], ahead=False)
        better = (behind >= 0) & (seen[behind] != 0)
        found[missing[better]] = behind[better]
        return found

    def _branch(self, points: FloatArray, *, ahead: bool) -> IntArray:
        cos_kappa, sin_kappa, kappa, a, k_t, k_z = self.mount[:6]
        t, x_axis, z_axis = self.mount[6:9], self.mount[9:12], self.mount[12:15]
        rho = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)
        sine = np.clip((k_t - k_z * points[:, 2]) / (a * rho), -1.0, 1.0)
        cosine = np.sqrt(1.0 - sine * sine)
        if not ahead:
            cosine = -cosine
        beta = np.arctan2(sine, cosine)
        forward = rho * (cos_kappa * cosine - sin_kappa * sine) - t[0]
        left = rho * (sin_kappa * cosine + cos_kappa * sine) - t[1]
        up = points[:, 2] - t[2]
        elevation = np.arctan2(
            forward * z_axis[0] + left * z_axis[1] + up * z_axis[2],
            forward * x_axis[0] + left * x_axis[1] + up * x_axis[2],
        )
        beam = self.beams[_cell(elevation)]
        yaw = np.arctan2(points[:, 1], points[:, 0]) - kappa - beta
        line = self.lines[_cell(yaw)]
        line = self.lines[_cell(yaw - self.offsets[line, beam])]
        found = line * self.offsets.shape[1] + beam
        return np.where((line >= 0) & (beam >= 0), found, -1)


def _cell(angles: FloatArray) -> IntArray:
    """Return the entry of the tables for ``angles`` [rad]."""
    turns = angles * (1.0 / math.tau)
    return ((turns - np.floor(turns)) * CELLS).astype(np.int64) % CELLS


def _table(angles: FloatArray) -> IntArray:
    """Return the index of the nearest of ``angles`` (n,) [rad] for each cell, -1 beyond reach."""
    centres = (np.arange(CELLS) + 0.5) * (math.tau / CELLS)
    folded = np.mod(angles, math.tau)
    order = np.argsort(folded, kind="stable")
    around = np.concatenate(
        ([folded[order[-1]] - math.tau], folded[order], [folded[order[0]] + math.tau])
    )
    index = np.concatenate(([order[-1]], order, [order[0]]))
    upper = np.clip(np.searchsorted(around, centres), 1, len(around) - 1)
    nearer = np.where(centres - around[upper - 1] <= around[upper] - centres, upper - 1, upper)
    spacing = median(np.abs(np.diff(angles)))
    near = np.abs(around[nearer] - centres) <= max(REACH * spacing, math.tau / CELLS)
    return np.where(near, index[nearer], -1).astype(np.int64)
