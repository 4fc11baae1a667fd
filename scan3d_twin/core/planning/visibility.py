"""What of the latest view another viewpoint would see, and how densely."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.surfels import X
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2, RangeImage, read_only

MIN_COSINE = 0.10
"""Flatter than this (84 deg from the normal) too little is seen to count on."""
CELL = (4, 6)
"""Lines and beams of a cell in which the nearest surface hides what lies behind it."""
THICKNESS, SLOPE = 0.04, 0.03
"""Depth of a cell that counts as one surface [m], and its growth per metre of range."""
MOST_DENSE = 4.0
"""A nearer viewpoint is not credited with more than so many readings for each one of now."""


@dataclass(frozen=True)
class Visible:
    """Surfels of the latest view that a viewpoint O2 sees again.

    Attributes:
        index: Of each in what was asked for (k,).
        ranges: From O2 [m] (k,).
        yaws: At which O2 sees each, from the middle of its sweep (k,) [rad].
        density: Readings of O2 for each reading of now (k,).
    """

    index: IntArray
    ranges: FloatArray
    yaws: FloatArray
    density: FloatArray


@dataclass(frozen=True)
class NextSweep:
    """The geometry of the sweep to come, the same from every viewpoint."""

    image: RangeImage
    projection: Projection

    @staticmethod
    def like(grid: SurfelGrid, half: float) -> NextSweep:
        """Return a sweep of ``half`` [rad] to either side by the lidar of ``grid``."""
        image, spacing = grid.image, grid.line_spacing
        yaws = np.arange(half, -half - spacing / 2, -spacing)
        shape = (len(yaws), image.spec.n_beams)
        empty = replace(
            image,
            stamps=read_only(np.arange(len(yaws)) * image.spec.line_period),
            yaws=read_only(np.repeat(yaws[:, None], shape[1], axis=1)),
            ranges=np.broadcast_to(np.nan, shape),
            codes=np.broadcast_to(np.int64(0), shape),
        )
        return NextSweep(empty, Projection.of(empty, spacing))

    def cells(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return reading (n,), -1 for none, and cell (n,) of ``points`` (n, 3) in its frame."""
        index = self.projection.lookup(points, np.ones(self.image.ranges.size, dtype=np.bool_))
        line, beam = np.divmod(index, self.image.spec.n_beams)
        wide = self.image.spec.n_beams // CELL[1] + 1
        return index, np.where(index >= 0, (line // CELL[0]) * wide + beam // CELL[1], 0)

    def ranges(self, points: FloatArray) -> FloatArray:
        """Return the distance (n,) [m] of ``points`` from the lidar when it looks at them."""
        t = self.image.T_base_lidar[:3, 3]
        ahead = np.hypot(points[:, 0], points[:, 1]) - t[0]
        return np.asarray(np.sqrt(ahead**2 + t[1] ** 2 + (points[:, 2] - t[2]) ** 2))


def visible_from(
    rows: FloatArray, here_ranges: FloatArray, viewpoint: Pose2, sweep: NextSweep, most: float
) -> Visible:
    """Return which surfels the sweep at ``viewpoint`` would see: front-facing, in view, not hidden.

    Args:
        rows: Surfels (n, 8) in the frame of the latest view.
        here_ranges: Their ranges there (n,) [m].
        viewpoint: O2 in that frame.
        sweep: The sweep to come.
        most: Longest range that is trusted [m].
    """
    x, y, z, nx, ny, nz = rows[:, :6].T
    height = sweep.image.T_base_lidar[2, 3]

    # As seen from there
    back = viewpoint.inverse()
    points = back.apply(rows[:, X])
    ranges = sweep.ranges(points)
    facing = nx * (viewpoint.x - x) + ny * (viewpoint.y - y) + nz * (height - z)
    cosines = facing / ranges
    index, cell = sweep.cells(points)
    inside = (index >= 0) & (ranges < most)
    kept = np.flatnonzero(inside & (cosines > MIN_COSINE) & ~_hidden(cell, ranges, inside))

    # Against now
    facing_here = -(nx * x + ny * y + nz * (z - height))[kept]
    here_cosines = facing_here / here_ranges[kept]
    ratio = cosines[kept] / np.maximum(here_cosines, MIN_COSINE)
    density = np.minimum(ratio * (here_ranges[kept] / ranges[kept]) ** 2, MOST_DENSE)
    yaws = np.arctan2(points[kept, 1], points[kept, 0])
    return Visible(kept, ranges[kept], yaws, density)


def _hidden(cell: IntArray, ranges: FloatArray, inside: BoolArray) -> BoolArray:
    """Tell which points lie behind the nearest surface of their cell."""
    nearest = np.full(int(cell.max(initial=0)) + 1, np.inf)
    np.minimum.at(nearest, cell[inside], ranges[inside])
    return np.asarray(ranges > nearest[cell] * (1 + SLOPE) + THICKNESS)


def ranges_here(rows: FloatArray, grid: SurfelGrid) -> FloatArray:
    """Return the ranges (n,) [m] at which surfels were measured."""
    t = grid.image.T_base_lidar[:3, 3]
    ahead = np.hypot(rows[:, 0], rows[:, 1]) - t[0]
    return np.asarray(np.sqrt(ahead**2 + t[1] ** 2 + (rows[:, 2] - t[2]) ** 2))
