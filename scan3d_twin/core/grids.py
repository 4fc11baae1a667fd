"""Binary grids of square cells: dilation, erosion, connected components and shortest paths.

``native/grids.h`` computes dilation and components.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, SmallIntArray, read_only


def dilate(grid: BoolArray, radius: float, cell: float = 1.0) -> BoolArray:
    """Return ``grid`` dilated by a disc: the cells within ``radius`` of one of its cells (nx, ny).

    Distances are between centres. The result equals a threshold on the distance transform, in a
    hundredth of the time for small discs.

    Args:
        grid: (nx, ny).
        radius: In the unit of ``cell``.
        cell: Side of a cell.
    """
    disc, result = _make_disc(radius, cell), np.empty(grid.shape, dtype=bool)
    if engine.dilate(np.ascontiguousarray(grid), *grid.shape, disc, len(disc), result) < 0:
        raise MemoryError
    return result


def label_components(grid: BoolArray) -> SmallIntArray:
    """Return the 8-connected components of ``grid`` (nx, ny) as labels 1, 2, ...; 0 is outside."""
    labels = np.empty(grid.shape, dtype=np.int32)
    if engine.label_components(np.ascontiguousarray(grid), *grid.shape, labels) < 0:
        raise MemoryError
    return labels


def erode(grid: BoolArray, radius: float, cell: float = 1.0) -> BoolArray:
    """Return ``grid`` eroded by a disc (nx, ny); beyond the border counts as outside.

    Args:
        grid: (nx, ny).
        radius: In the unit of ``cell``.
        cell: Side of a cell.
    """
    inside, part = np.zeros_like(grid), _bound(grid)
    outside = np.pad(~grid[part], 1, constant_values=True)
    inside[part] = ~dilate(outside, radius, cell)[1:-1, 1:-1]
    return inside


def _bound(grid: BoolArray) -> tuple[slice, slice]:
    """Return the bounding box of the cells of ``grid`` (nx, ny), as slices."""
    rows, columns = np.flatnonzero(grid.any(axis=1)), np.flatnonzero(grid.any(axis=0))
    if len(rows) == 0:
        return np.s_[:0, :0]
    return np.s_[int(rows[0]) : int(rows[-1]) + 1, int(columns[0]) : int(columns[-1]) + 1]


@lru_cache(64)
def _make_disc(radius: float, cell: float) -> IntArray:
    """Return row offset and half width (k, 2), in cells, of the rows of a disc to one side."""
    reach = max(0, math.floor(radius / cell) + 1)
    away = np.hypot(*np.indices((reach + 1, reach + 1))) * cell <= radius
    rows = [(i, int(row.sum()) - 1) for i, row in enumerate(away) if row[0]]
    return read_only(np.array(rows).reshape(-1, 2), np.int64)


def find_connected(grid: BoolArray, start: tuple[int, int]) -> BoolArray:
    """Return the component (nx, ny) of ``grid`` that is connected to its cell ``start``."""
    part = _bound(grid)
    labels = label_components(grid[part])
    reached = np.zeros_like(grid)
    reached[part] = labels == labels[start[0] - part[0].start, start[1] - part[1].start]
    return reached


def find_shortest_paths(
    grid: BoolArray, start: tuple[int, int], cell: float
) -> tuple[FloatArray, IntArray]:
    """Return the shortest paths from ``start`` to all cells, by Dijkstra's algorithm.

    Args:
        grid: Connected cells (nx, ny); n = nx ny.
        start: One of them.
        cell: Side of a cell; the lengths are in its unit.

    Returns:
        Length of the path to each cell (n,), inf outside of ``grid``; and the flat index of the
        cell before it on the path (n,), negative for none.
    """
    places = np.flatnonzero(grid)
    way, before = np.full(grid.size, np.inf), np.full(grid.size, -1)
    first = np.searchsorted(places, np.ravel_multi_index(start, grid.shape))
    found, previous = csgraph.dijkstra(
        _make_graph(grid, cell), indices=np.array([first]), return_predecessors=True
    )
    way[places] = found[0]
    before[places] = np.where(previous[0] >= 0, places[np.maximum(previous[0], 0)], -1)
    return way, before


def _make_graph(grid: BoolArray, cell: float) -> sparse.csr_array:
    """Return the 8-connected graph of the cells of ``grid``, weighted by distance."""
    n = np.count_nonzero(grid)
    index = np.zeros(grid.shape, dtype=np.int64)
    index[grid] = np.arange(n)

    # Link neighbours in four directions.
    rows, columns, weights = [], [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = np.s_[: -dx or None, max(0, -dy) : (-dy if dy > 0 else None)]
        b = np.s_[dx:, (dy if dy > 0 else 0) : (dy if dy < 0 else None)]
        linked = grid[a] & grid[b]
        rows.append(index[a][linked])
        columns.append(index[b][linked])
        weights.append(np.full(np.count_nonzero(linked), cell * np.hypot(dx, dy)))

    # Make the links symmetric.
    i, j, w = (np.concatenate(part) for part in (rows, columns, weights))
    return sparse.csr_array(
        (np.tile(w, 2), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n)
    )
