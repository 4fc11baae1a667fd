"""Nearest neighbours of many points at once, with array types."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.types import FloatArray, IntArray


def nearest(
    tree: cKDTree, points: FloatArray, within: float = math.inf
) -> tuple[FloatArray, IntArray]:
    """Return distance (n,) [m] and index (n,) of each point's nearest neighbour in ``tree``.

    Where there is none closer than ``within`` [m] the distance is inf and the index ``tree.n``.
    """
    distance, index = tree.query(points, distance_upper_bound=within)
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.int64)
