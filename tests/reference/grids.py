"""Plain forms of ``native/grids.h``, by SciPy."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray


def dilate(grid: BoolArray, radius: float) -> BoolArray:
    """Return the cells (nx, ny) within ``radius`` of one of ``grid``, from middle to middle."""
    if not grid.any():
        return np.zeros_like(grid)
    return np.asarray(ndimage.distance_transform_edt(~grid) <= radius)


def label_cells(grid: BoolArray) -> IntArray:
    """Return the labels (nx, ny) of the 8-connected components of ``grid``."""
    return np.asarray(ndimage.label(grid, structure=np.ones((3, 3)))[0])


def piece_sizes(ranges: FloatArray, there: BoolArray, most: float) -> IntArray:
    """Return the size (n,) of the component of each reading ``there`` (m, n), in their order.

    Readings lie on every second place of a grid, and on those between them what joins two.
    """
    n, m = ranges.shape
    grid = np.zeros((2 * n - 1, 2 * m - 1), dtype=bool)
    grid[::2, ::2] = there
    across = np.abs(np.diff(ranges, axis=0)) < most
    along = np.abs(np.diff(ranges, axis=1)) < most
    grid[1::2, ::2] = across & there[:-1] & there[1:]
    grid[::2, 1::2] = along & there[:, :-1] & there[:, 1:]
    labels = ndimage.label(grid)[0][::2, ::2][there]
    return np.asarray(np.bincount(labels)[labels])
