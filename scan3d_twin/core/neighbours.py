"""Nearest-neighbour search for many points at once, with array types."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.types import FloatArray, IntArray


def find_nearest(
    tree: cKDTree, points: FloatArray, within: float = math.inf
) -> tuple[FloatArray, IntArray]:
    """Return distance (n,) [m] and index (n,) of each point's nearest neighbour in ``tree``.

    A point without a neighbour closer than ``within`` [m] gets the distance inf and the index
    ``tree.n``.
    """
    distance, index = tree.query(points, distance_upper_bound=within)
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.int64)
