"""Projection of a point onto the line and beam of a yawing scanner that see it, in closed form.

The scan plane at yaw psi has the normal Rz(psi) k, k = R_base_lidar e_y, and contains the lidar at
Rz(psi) t. A point at azimuth phi and distance rho from the yaw axis lies in it where

    k . Rz(-psi) p = k . t   <=>   phi - psi = kappa + beta  or  kappa + pi - beta,
    sin(beta) = (k . t - k_z z) / (a rho),

with a and kappa + pi / 2 the length and azimuth of k in the plane of the floor. The first solution
is seen ahead of the axis, the second over the zenith behind it. In the scan plane the elevation
follows from the point relative to the lidar. Tables then give the nearest line and beam.

The tables are indexed without computing an angle: by a pseudo-angle, the position of a direction
(c, s) along the square |c| + |s| = 1. It grows with the angle, by (c^2 + s^2) / (|c| + |s|)^2 per
radian.

Where the lines of a sweep have elevations of their own, the table gives the beam nominally nearest,
and the nearest of the line's beams around it is taken.

``native/projection.h`` computes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np

from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import (
    UNMEASURED,
    BoolArray,
    FloatArray,
    IntArray,
    RangeImage,
    SmallIntArray,
    read_only,
)

CELLS = 16384
"""Entries of the tables over a full turn: 0.016 to 0.031 deg each."""


@dataclass(frozen=True)
class Projection:
    """Look-up tables of one sweep, and the mount of its lidar.

    Attributes:
        lines: Line by yaw of its middle beam (CELLS,); -1 where there is none.
        beams: Beam by elevation (CELLS,); -1 where there is none.
        yaws: Yaw of each beam (n_lines, n_beams) [rad].
        middles: Yaw of each line's middle beam (n_lines,) [rad]; within a tenth of a second the
            yaws of the other beams are near it.
        mount: cos kappa, sin kappa, a, k . t, k_z, then t (3), x axis (3), z axis (3) of the lidar
            in ``base`` (14,).
        backwards: Whether any beam looks back over the zenith or the nadir.
        elevations: Elevation of each reading in entries of the tables (n_lines, n_beams), infinite
            where the line has no beam; None if the lines agree.
        search: Beams to either side of the nominally nearest among which a line's nearest one is.
    """

    lines: SmallIntArray
    beams: SmallIntArray
    yaws: FloatArray
    middles: FloatArray
    mount: FloatArray
    backwards: bool
    elevations: FloatArray | None
    search: int

    @staticmethod
    def of(image: RangeImage, line_spacing: float) -> Projection:
        """Return the projection of a sweep with lines typically ``line_spacing`` [rad] apart."""
        middles = image.yaws[:, image.spec.n_beams // 2].copy()
        elevations = np.ascontiguousarray(image.spec.elevations).tobytes()
        beams, mount, backwards = _project_lidar(elevations, image.T_base_lidar.tobytes())
        lines = tabulate_nearest(middles, line_spacing)
        own, search = _locate_beams(image)
        return Projection(
            lines, beams, read_only(image.yaws), middles, mount, backwards, own, search
        )

    @cached_property
    def value(self) -> native.Projection:
        """The projection as the engine takes it."""
        n_lines, n_beams = self.yaws.shape
        return native.Projection(
            n_lines=n_lines,
            n_beams=n_beams,
            lines=self.lines,
            beams=self.beams,
            elevations=self.elevations,
            search=self.search,
            yaws=self.yaws,
            middles=self.middles,
            mount=self.mount,
            backwards=self.backwards,
        )

    def lookup(self, points: FloatArray, seen: BoolArray) -> IntArray:
        """Return the flat index of the reading (m,) that sees each of ``points`` (m, 3), or -1.

        If two readings see it, the one ahead of the axis counts, unless ``seen`` is False there.

        Args:
            points: Points in frame ``scan`` [m].
            seen: Whether a reading counts (n_lines * n_beams,).
        """
        found = np.empty(len(points), dtype=np.int64)
        engine.find_readings(self.value, np.ascontiguousarray(points), len(points), seen, found)
        return found


def tabulate_nearest(angles: FloatArray, spacing: float) -> SmallIntArray:
    """Return for each cell the index of the nearest of ``angles`` (n,) [rad], -1 if none is near.

    Args:
        angles: Monotonic angles, of any multiple of a turn.
        spacing: Typical spacing between two of them [rad].
    """
    table = np.empty(CELLS, dtype=np.int32)
    angles = np.ascontiguousarray(angles)
    if engine.tabulate_nearest(angles, len(angles), spacing, _cell_centres(), table) < 0:
        raise MemoryError
    return table


def _locate_beams(image: RangeImage) -> tuple[FloatArray | None, int]:
    """Return ``elevations`` and ``search`` of a sweep.

    Where beams are at most a spacing apart, the one nearest to a direction is at most half a
    spacing from it, as is the nominally nearest; the shift of the beams comes on top.
    """
    own, nominal = image.elevations, image.spec.elevations
    if own is None:
        return None, 0
    cells, measured = np.empty(own.shape), image.codes != UNMEASURED
    engine.locate_angles(read_only(own), own.size, cells)
    shift = np.max(np.abs(own - nominal), where=measured, initial=0.0)
    spacing = float(np.median(np.abs(np.diff(nominal))))
    return np.where(measured, cells, math.inf), 1 + math.ceil(shift / max(spacing, 1e-9))


@lru_cache(maxsize=16)
def _project_lidar(
    elevations: bytes, T_base_lidar: bytes
) -> tuple[SmallIntArray, FloatArray, bool]:
    """Return ``beams``, ``mount`` and ``backwards``, which all sweeps of a lidar share."""
    angles, T = np.frombuffer(elevations), np.frombuffer(T_base_lidar).reshape(4, 4)
    R, t = T[:3, :3], T[:3, 3]
    k = R[:, 1]
    kappa = math.atan2(k[1], k[0]) - math.pi / 2
    a = max(math.hypot(k[0], k[1]), 1e-9)
    head = [math.cos(kappa), math.sin(kappa), a, float(k @ t), k[2]]
    beams = tabulate_nearest(angles, float(np.median(np.abs(np.diff(angles)))))
    back = bool(np.any(beams[CELLS // 4 : 3 * CELLS // 4] >= 0))
    return beams, np.concatenate([head, t, R[:, 0], R[:, 2]]), back


@cache
def _cell_centres() -> FloatArray:
    """Return the angles in the middle of the tables' entries (CELLS,) [rad]."""
    centres = np.empty(CELLS)
    engine.write_cell_centres(centres)
    return read_only(centres)
