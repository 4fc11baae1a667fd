"""Boolean grids of square cells: dilation and erosion by a disc, connectivity, shortest paths.

``native/grids.h`` and ``native/paths.h`` have the loops.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, SmallIntArray, read_only


def dilate(grid: BoolArray, radius: float, cell: float = 1.0) -> BoolArray:
    """Return the cells (nx, ny) whose middle is within ``radius`` of that of a cell of ``grid``.

    The same as a threshold on the distance transform, in a hundredth of its time for small discs.

    Args:
        grid: (nx, ny).
        radius: In the unit of ``cell``.
        cell: Side of a cell.
    """
    disc, result = _disc(radius, cell), np.empty(grid.shape, dtype=bool)
    if engine.dilate(np.ascontiguousarray(grid), *grid.shape, disc, len(disc), result) < 0:
        raise MemoryError
    return result


def label_cells(grid: BoolArray) -> SmallIntArray:
    """Return a number (nx, ny) for each cell: 0 outside of ``grid`` (nx, ny).

    Connected cells, also those that touch at a corner only, share one. They count from 1.
    """
    labels = np.empty(grid.shape, dtype=np.int32)
    if engine.label_components(np.ascontiguousarray(grid), *grid.shape, labels) < 0:
        raise MemoryError
    return labels


def erode(grid: BoolArray, radius: float, cell: float = 1.0) -> BoolArray:
    """Return the cells (nx, ny) of ``grid`` with no other cell within ``radius``, nor the border.

    Args:
        grid: (nx, ny).
        radius: In the unit of ``cell``.
        cell: Side of a cell.
    """
    inside, part = np.zeros_like(grid), _bounding_box(grid)
    outside = np.pad(~grid[part], 1, constant_values=True)
    inside[part] = ~dilate(outside, radius, cell)[1:-1, 1:-1]
    return inside


def _bounding_box(grid: BoolArray) -> tuple[slice, slice]:
    """Return the slices of the smallest box that holds all cells of ``grid`` (nx, ny)."""
    rows, columns = np.flatnonzero(grid.any(axis=1)), np.flatnonzero(grid.any(axis=0))
    if len(rows) == 0:
        return np.s_[:0, :0]
    return np.s_[int(rows[0]) : int(rows[-1]) + 1, int(columns[0]) : int(columns[-1]) + 1]


@lru_cache(64)
def _disc(radius: float, cell: float) -> IntArray:
    """Return (row offset, half width) (k, 2) [cells] of the rows of half a disc."""
    reach = max(0, math.floor(radius / cell) + 1)
    away = np.hypot(*np.indices((reach + 1, reach + 1))) * cell <= radius
    rows = [(i, int(row.sum()) - 1) for i, row in enumerate(away) if row[0]]
    return read_only(np.array(rows).reshape(-1, 2), np.int64)


def find_connected(grid: BoolArray, start: tuple[int, int]) -> BoolArray:
    """Return the cells (nx, ny) of ``grid`` that are connected with ``start``, one of them."""
    part = _bounding_box(grid)
    labels = label_cells(grid[part])
    reached = np.zeros_like(grid)
    reached[part] = labels == labels[start[0] - part[0].start, start[1] - part[1].start]
    return reached


def find_shortest_paths(
    grid: BoolArray, start: tuple[int, int], cell: float
) -> tuple[FloatArray, IntArray]:
    """Return the shortest paths from ``start`` to all cells of ``grid``, by Dijkstra's algorithm.

    Args:
        grid: Cells that are all connected with ``start`` (nx, ny); n = nx ny.
        start: One of the cells.
        cell: Side of a cell; the unit of the path lengths.

    Returns:
        By flat index: the length of the path to each cell (n,), inf outside of ``grid``, and the
        cell before it on the path (n,), -1 for none.
    """
    length, before = np.empty(grid.size), np.empty(grid.size, np.int64)
    done = engine.find_shortest_paths(
        np.ascontiguousarray(grid), *grid.shape, np.ravel_multi_index(start, grid.shape),
        cell, cell * math.sqrt(2.0), length, before,
    )  # fmt: skip
    if done < 0:
        raise MemoryError
    return length, before
