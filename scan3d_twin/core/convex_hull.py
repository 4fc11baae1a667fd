"""Convex hull of points in the plane."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray


def find_convex_hull(points: FloatArray) -> IntArray:
    """Return the indices of the corners of the convex hull of ``points`` (n, 2), anticlockwise.

    By monotone chains (Andrew, Inf. Process. Lett. 9, 1979); all points may be on one line.
    """
    order = np.lexsort(points.T[::-1]).tolist()
    places = points.tolist()
    lower, upper = _chain(order, places), _chain(order[::-1], places)
    return np.array([*lower[:-1], *upper[:-1]] or order[:1], dtype=np.int64)


def _chain(order: list[int], places: list[list[float]]) -> list[int]:
    """Return the corners of one side of the hull, of points in this ``order``."""
    corners: list[int] = []
    for index in order:
        x, y = places[index]
        while len(corners) >= 2:
            (ax, ay), (bx, by) = places[corners[-2]], places[corners[-1]]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                break
            corners.pop()
        corners.append(index)
    return corners
