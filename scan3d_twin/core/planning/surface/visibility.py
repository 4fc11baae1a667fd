"""Visibility: which surfels of the latest view another viewpoint would see, and how densely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.registration.surfels.extraction import X
from scan3d_twin.core.registration.surfels.projection import Projection
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2, RangeImage, read_only

MIN_COSINE = 0.25
"""Cosine of the incidence below which (75 deg) a surfel does not count as visible: of those seen
at 80 to 85 deg by a sweep of random scenes, 45 % have a match there, up to 75 deg 90 % (3879 and
236531 surfels)."""
DEPTH_CELL = (4, 6)
"""Lines and beams of a cell in which the nearest surface hides what is behind it."""
SURFACE_DEPTH, DEPTH_PER_METRE = 0.04, 0.03
"""Depth of one surface within a cell [m], and its growth per metre of range."""
MAX_DENSITY = 4.0
"""Largest number of readings from a nearer viewpoint that count for each reading of the latest
view."""


@dataclass(frozen=True)
class Visible:
    """Surfels of the latest view that a viewpoint O2 sees again.

    Attributes:
        index: Row of each surfel (k,).
        ranges: Range of each from O2 (k,) [m].
        yaws: Yaw of each from the middle of the sweep at O2 (k,) [rad].
        density: Number of readings from O2 for each reading of the latest view (k,).
    """

    index: IntArray
    ranges: FloatArray
    yaws: FloatArray
    density: FloatArray


@dataclass(frozen=True)
class NextSweep:
    """The geometry of the next sweep, the same from every viewpoint."""

    image: RangeImage
    projection: Projection

    @staticmethod
    def like(grid: SurfelGrid, half: float) -> NextSweep:
        """Return an empty sweep of ``half`` [rad] to either side by the lidar of ``grid``."""
        image, spacing = grid.image, grid.line_spacing
        yaws = np.arange(half, -half - spacing / 2, -spacing)
        shape = (len(yaws), image.spec.n_beams)
        empty = replace(
            image,
            stamps=read_only(np.arange(len(yaws)) * image.spec.line_period),
            yaws=read_only(np.repeat(yaws[:, None], shape[1], axis=1)),
            ranges=np.broadcast_to(np.nan, shape),
            codes=np.broadcast_to(np.int64(0), shape),
            elevations=None,
        )
        return NextSweep(empty, Projection.of(empty, spacing))

    @cached_property
    def _all_readings(self) -> BoolArray:
        """A mask that keeps every reading (n_lines * n_beams,)."""
        return np.ones(self.image.ranges.size, dtype=np.bool_)

    def cells(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return reading (n,), -1 for none, and cell (n,) of ``points`` (n, 3) in ``scan``."""
        index = self.projection.lookup(points, self._all_readings)
        line, beam = np.divmod(index, self.image.spec.n_beams)
        wide = self.image.spec.n_beams // DEPTH_CELL[1] + 1
        return index, np.where(
            index >= 0, (line // DEPTH_CELL[0]) * wide + beam // DEPTH_CELL[1], 0
        )

    def ranges(self, points: FloatArray) -> FloatArray:
        """Return the distance (n,) [m] of ``points`` from the lidar when it looks at them."""
        t = self.image.T_base_lidar[:3, 3]
        ahead = np.hypot(points[:, 0], points[:, 1]) - t[0]
        return np.asarray(np.sqrt(ahead**2 + t[1] ** 2 + (points[:, 2] - t[2]) ** 2))


def find_visible(
    rows: FloatArray, here_ranges: FloatArray, viewpoint: Pose2, sweep: NextSweep, most: float
) -> Visible:
    """Return the surfels that a sweep at ``viewpoint`` would see: facing it, in view, not hidden.

    Args:
        rows: Surfels (n, 8) in the frame of the latest view.
        here_ranges: Their ranges in the latest view (n,) [m].
        viewpoint: O2 in that frame.
        sweep: The next sweep.
        most: Longest range that is trusted [m].
    """
    x, y, z, nx, ny, nz = rows[:, :6].T
    height = sweep.image.T_base_lidar[2, 3]

    # Find those visible from O2
    back = viewpoint.inverse()
    points = back.apply(rows[:, X])
    ranges = sweep.ranges(points)
    facing = nx * (viewpoint.x - x) + ny * (viewpoint.y - y) + nz * (height - z)
    cosines = facing / ranges
    index, cell = sweep.cells(points)
    inside = (index >= 0) & (ranges < most)
    kept = np.flatnonzero(inside & (cosines > MIN_COSINE) & ~_find_hidden(cell, ranges, inside))

    # Compare with the latest view
    facing_here = -(nx * x + ny * y + nz * (z - height))[kept]
    here_cosines = facing_here / here_ranges[kept]
    ratio = cosines[kept] / np.maximum(here_cosines, MIN_COSINE)
    density = np.minimum(ratio * (here_ranges[kept] / ranges[kept]) ** 2, MAX_DENSITY)
    yaws = np.arctan2(points[kept, 1], points[kept, 0])
    return Visible(kept, ranges[kept], yaws, density)


def _find_hidden(cell: IntArray, ranges: FloatArray, inside: BoolArray) -> BoolArray:
    """Return which points are behind the nearest surface of their cell (n,)."""
    nearest = np.full(int(cell.max(initial=0)) + 1, np.inf)
    np.minimum.at(nearest, cell[inside], ranges[inside])
    return np.asarray(ranges > nearest[cell] * (1 + DEPTH_PER_METRE) + SURFACE_DEPTH)


def measure_ranges(rows: FloatArray, grid: SurfelGrid) -> FloatArray:
    """Return the ranges (n,) [m] at which the surfels ``rows`` were measured."""
    t = grid.image.T_base_lidar[:3, 3]
    ahead = np.hypot(rows[:, 0], rows[:, 1]) - t[0]
    return np.asarray(np.sqrt(ahead**2 + t[1] ** 2 + (rows[:, 2] - t[2]) ** 2))
