"""Walls: vertical planes that are higher and longer than a target, found in the points of a scan.

The lidar sees far above the vertical window that is modelled, so that a wall shows its height. Its
lines in the top view are found by the Hough transform (R. O. Duda and P. E. Hart, Use of the Hough
transformation to detect lines and curves in pictures, Comm. ACM 15, 1972) and fitted to the points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import BoolArray, FloatArray

MIN_HEIGHT = 1.8
"""Height that a wall reaches [m]: more than the things that are scanned; rooms are 2.3 m and
higher."""
MIN_COLUMN = 0.5
"""Least vertical extent of a wall above what stands before it [m]."""
MIN_LENGTH = 1.0
"""Least length of a wall in view [m]."""
MIN_CELLS = 8
"""Fewest cells of the top view in a wall: every 0.2 m in one of 1.6 m."""
THICKNESS = 0.03
"""Distance from a wall's plane within which points are on it [m]: 3 sigma of the range noise."""
SIGHT_MARGIN = 0.15
"""Part of the height in sight that may be missing at the end of the range [m]."""
END_MARGIN = 0.30
"""Distance beyond a wall's ends in view to which it is taken to go on [m]: spacing of lines."""
MAX_WALLS = 8
"""Largest number of walls that are looked for."""
MIN_FILLED = 0.7
"""Least share of a column's height in which points were seen."""
_CELL, _LEVEL = 0.05, 0.10
_ANGLES = np.radians(np.arange(180.0))
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


@dataclass(frozen=True, eq=False)
class Wall:
    """A piece of a vertical plane in the top view of the frame ``scan``.

    Attributes:
        normal: Unit normal (2,), towards the robot at the origin.
        offset: Signed distance of the plane along the normal, negative [m].
        low, high: Its ends along the plane [m], left of the normal positive.
    """

    normal: FloatArray
    offset: float
    low: float
    high: float

    def distance(self, points: FloatArray) -> FloatArray:
        """Return how far ``points`` (n, 2) are from the plane (n,) [m], positive before it."""
        return np.asarray(points @ self.normal - self.offset)

    def contains(self, points: FloatArray, tolerance: float = THICKNESS) -> BoolArray:
        """Return which ``points`` (n, 2) are on the wall, within ``tolerance`` [m] (n,)."""
        along = points @ np.array([-self.normal[1], self.normal[0]])
        inside = (along >= self.low - END_MARGIN) & (along <= self.high + END_MARGIN)
        return np.asarray(inside & (np.abs(self.distance(points)) <= tolerance))


def find_walls(points: FloatArray, max_range: float) -> list[Wall]:
    """Return the walls among all ``points`` (n, 3) of a scan, longest first.

    Args:
        points: In ``scan``, of all heights, without the floor [m].
        max_range: Longest range that is used [m].
    """
    cells = _find_tall_cells(points, max_range)
    walls: list[Wall] = []
    while len(cells) >= MIN_CELLS and len(walls) < MAX_WALLS:
        member = _find_line(cells)
        if np.count_nonzero(member) < MIN_CELLS:
            break
        wall = _fit_wall(cells[member])
        if wall.high - wall.low >= MIN_LENGTH:
            walls.append(wall)
        cells = cells[~(member | wall.contains(cells, 2 * _CELL))]
    return walls


def is_on_walls(points: FloatArray, walls: Sequence[Wall]) -> BoolArray:
    """Return which ``points`` (n, 2) are on any of the ``walls`` (n,)."""
    found = np.zeros(len(points), dtype=bool)
    for wall in walls:
        found |= wall.contains(points)
    return found


def reaches_wall_height(points: FloatArray, max_range: float, slope: float) -> BoolArray:
    """Return which ``points`` (n, 3) are as high as a wall would be seen at their distance (n,).

    Args:
        points: In ``scan`` [m].
        max_range: Longest range that is used [m].
        slope: Tangent of the highest elevation that is seen; inf where that is the zenith.
    """
    distance = np.minimum(np.hypot(points[:, 0], points[:, 1]), max_range)
    sight = np.minimum(np.sqrt(max_range**2 - distance**2), slope * distance)
    return np.asarray(points[:, 2] >= np.minimum(MIN_HEIGHT, LIDAR_HEIGHT + sight - SIGHT_MARGIN))


def _find_tall_cells(points: FloatArray, max_range: float) -> FloatArray:
    """Return the mean top-view points (n, 2) of the cells in which a tall column was seen.

    At the end of the range, the column need not be higher than the lidar can see there. A ceiling
    above a thing is no column: most of the heights in between must be filled.
    """
    if len(points) == 0:
        return np.zeros((0, 2))

    # Number the cells and their levels
    places = np.floor(points / (_CELL, _CELL, _LEVEL)).astype(np.int64)
    places -= places.min(axis=0)
    sizes = places.max(axis=0) + 1
    number = places[:, 0] * sizes[1] + places[:, 1]
    _, levels = np.unique(
        np.unique(number * sizes[2] + places[:, 2]) // sizes[2], return_counts=True
    )
    cells, cell = np.unique(number, return_inverse=True)

    # Measure each cell's column
    top, bottom = np.full(len(cells), -np.inf), np.full(len(cells), np.inf)
    np.maximum.at(top, cell, points[:, 2])
    np.minimum.at(bottom, cell, points[:, 2])

    # Keep the tall ones
    n = np.bincount(cell)
    middle = np.stack([np.bincount(cell, points[:, i]) / n for i in (0, 1)], axis=1)
    tall = reaches_wall_height(np.column_stack([middle, top]), max_range, math.inf)
    tall &= top - bottom >= np.minimum(MIN_COLUMN, top / 2)
    kept = tall & (levels * _LEVEL >= MIN_FILLED * (top - bottom))
    return np.asarray(middle[kept])


def _find_line(cells: FloatArray) -> BoolArray:
    """Return which ``cells`` (n, 2) are on the line that most of them are on (n,)."""
    # Let each cell vote for all lines through it
    offsets = cells @ _DIRECTIONS
    bins = np.round(offsets / _CELL).astype(np.int64)
    low = bins.min()
    n_bins = int(bins.max() - low) + 1
    votes = np.bincount(
        (np.arange(len(_ANGLES)) * n_bins + bins - low).ravel(), minlength=len(_ANGLES) * n_bins
    ).reshape(len(_ANGLES), n_bins)

    # Take the cells within a cell of the best line
    angle, offset = np.unravel_index(int(np.argmax(votes)), votes.shape)
    return np.asarray(np.abs(offsets[:, angle] - (offset + low) * _CELL) <= _CELL)


def _fit_wall(cells: FloatArray) -> Wall:
    """Return the wall through ``cells`` (n, 2), by total least squares."""
    middle = cells.mean(axis=0)
    normal = np.linalg.eigh((cells - middle).T @ (cells - middle))[1][:, 0]
    offset = float(middle @ normal)
    if offset > 0:
        normal, offset = -normal, -offset
    along = cells @ np.array([-normal[1], normal[0]])
    return Wall(normal, offset, float(along.min()), float(along.max()))
