"""Moving windows over arrays: means, maxima, and whether all of a window is set."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray


def moving_mean(values: FloatArray, size: int, axis: int) -> FloatArray:
    """Return the means of ``values`` (m, n) over windows of ``size`` along an ``axis``, (m, n).

    Ends are mirrored. The sum of a window follows from that of the one before, as in
    ``scipy.ndimage.uniform_filter1d``, whose import takes 24 MB and a tenth of a second;
    ``native/windows.h`` has the loop.
    """
    values, means = np.ascontiguousarray(values), np.empty(values.shape)
    (m, n), inner = values.shape, values.shape[1] if axis == 0 else 1
    outer, length = (1, m) if axis == 0 else (m, n)
    if engine.average_windows(values, outer, length, inner, size, means) < 0:
        raise MemoryError
    return means


def moving_maximum(values: FloatArray, size: int) -> FloatArray:
    """Return the maxima of ``values`` (m, n) over squares of an odd ``size``; inf at the border."""
    m, n = values.shape
    half = size // 2
    padded = np.pad(values, half, constant_values=np.inf)
    rows = padded[:m].copy()
    for k in range(1, size):
        np.maximum(rows, padded[k : k + m], out=rows)
    result = rows[:, :n].copy()
    for k in range(1, size):
        np.maximum(result, rows[:, k : k + n], out=result)
    return result


def are_all(mask: BoolArray, size: int, axis: int, beyond: bool) -> BoolArray:
    """Return where all of a window of ``size`` along an ``axis`` of ``mask`` is set (m, n).

    Args:
        mask: (m, n).
        size: Number of entries; an even window has its longer half before its middle.
        axis: 0 or 1.
        beyond: What the mask counts as beyond its ends.
    """
    before, columns = size // 2, np.moveaxis(mask, axis, 0)
    width = [(before, size - 1 - before), (0, 0)]
    padded = np.pad(columns, width, constant_values=beyond)
    whole, covered = padded, 1
    while covered < size:
        more = min(covered, size - covered)
        whole = whole[: len(whole) - more] & whole[more:]
        covered += more
    return np.asarray(np.moveaxis(whole, 0, axis))


def open_by_box(mask: BoolArray, sizes: Sequence[int]) -> BoolArray:
    """Return what boxes of ``sizes`` cover that fit into ``mask`` (m, n), a morphological opening.

    They may reach beyond its border.
    """
    covered = mask
    for axis, size in enumerate(sizes):
        covered = are_all(covered, size, axis, beyond=True)
    for axis, size in enumerate(sizes):
        rest = are_all(~np.flip(covered, axis), size, axis, beyond=True)
        covered = ~np.flip(rest, axis)
    return covered
