"""What a sweep shows of the floor on a grid of cells, cell by cell, in NumPy."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.navigation.costmap import FREE, OBSTACLE, RESOLUTION, TOUCHED
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2


def mark_floor(
    cells: IntArray,
    origin: FloatArray,
    pose: Pose2,
    yaws: FloatArray,
    reach: FloatArray,
    points: FloatArray,
) -> IntArray:
    """Return ``cells`` (nx, ny) with the free ones and then the obstacles, touched ones kept.

    Args:
        cells: Values of the cells before.
        origin: Corner of cell (0, 0) (2,) [m].
        pose: ``T_odom_scan`` of the sweep.
        yaws: Headings of its lines, falling (n,) [rad].
        reach: Distance to which each sees a free floor (n,) [m].
        points: Top view of the obstacles (m, 2) in ``scan`` [m].
    """
    # Free cells, by their middles
    result = cells.copy()
    i, j = np.indices(cells.shape)
    middles = np.stack([i + 0.5, j + 0.5], axis=-1) * RESOLUTION + origin
    local = pose.inverse().apply(middles)
    result[_is_swept(local[..., 0], local[..., 1], yaws, reach)] = FREE

    # Obstacles within the grid
    at = np.floor((pose.apply(points) - origin) / RESOLUTION).astype(np.int64)
    at = at[np.all((at >= 0) & (at < cells.shape), axis=1)]
    result[at[:, 0], at[:, 1]] = OBSTACLE
    return np.where(cells == TOUCHED, TOUCHED, result)


def _is_swept(x: FloatArray, y: FloatArray, yaws: FloatArray, reach: FloatArray) -> BoolArray:
    """Return which places ``x``, ``y`` (nx, ny) are between two lines and within their reach."""
    bearing, distance = np.arctan2(y, x), np.hypot(x, y)
    middle = (yaws[0] + yaws[-1]) / 2
    bearing = middle + (bearing - middle + math.pi) % math.tau - math.pi
    left = np.searchsorted(-yaws, -bearing, side="right") - 1
    between = (left >= 0) & (left < len(yaws) - 1)
    left = np.clip(left, 0, len(yaws) - 2)
    return np.asarray(between & (distance <= np.minimum(reach[left], reach[left + 1])))
