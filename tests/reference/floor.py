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


def find_hidden(
    surface: BoolArray,
    origin: FloatArray,
    side: float,
    points: FloatArray,
    normals: FloatArray,
    slices: IntArray,
    place: FloatArray,
    steps: FloatArray,
) -> BoolArray:
    """Return which faces (n,) are hidden from ``place`` (2,) by surface in their slice.

    Args:
        surface: Cells of each slice in which surface was seen (n_slices, nx, ny).
        origin: Corner of cell (0, 0) (2,) [m].
        side: Side of a cell [m].
        points: Top view of the faces (n, 2) [m].
        normals: Their outward normals (n, 2).
        slices: The slice of each (n,).
        place: Where the lidar is.
        steps: Distances from the faces, less one cell, that are tested [m].
    """
    starts = points + side * normals
    lengths = np.linalg.norm(place - starts, axis=1)
    on_rays = starts[:, None] + steps[:, None] * ((place - starts) / lengths[:, None])[:, None]
    end = origin + side * np.array(surface.shape[1:])
    inside = np.all((on_rays >= origin) & (on_rays < end), axis=-1) & (steps < lengths[:, None])
    cells = np.floor((on_rays - origin) / side).astype(np.int64)
    cells = np.clip(cells, 0, np.array(surface.shape[1:]) - 1)
    met = surface[slices[:, None], cells[..., 0], cells[..., 1]]
    return np.asarray((met & inside).any(axis=1))
