"""Nearest neighbours of points: a k-d tree with plane fits, and a test for points nearby.

``native/clouds.h`` holds the tree and fits the planes, ``native/near.h`` sorts points into cubes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.native import MAX_NEIGHBOURS, ByteArray, engine
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, SmallIntArray


@dataclass(frozen=True)
class Tree:
    """A k-d tree of points.

    Attributes:
        points: In the order of the tree (n, 3) [m].
        order: Index of each point before sorting (n,).
        axes: Axis along which each point splits its part of the tree (n,); leaves have none.
    """

    points: FloatArray
    order: SmallIntArray
    axes: ByteArray

    @staticmethod
    def of(points: FloatArray) -> Tree:
        """Return the tree of ``points`` (n, 2 or 3), all finite."""
        points, n = _make_spatial(points), len(points)
        tree = Tree(np.empty((n, 3)), np.empty(n, np.int32), np.zeros(n, np.uint8))
        engine.build_tree(points, n, tree.points, tree.order, tree.axes)
        return tree

    def nearest(self, points: FloatArray, k: int) -> tuple[FloatArray, SmallIntArray]:
        """Return squared distances [m2] and indices (m, k) of the k nearest neighbours of points.

        Nearest first; infinity and -1 where the tree has fewer points.

        Raises:
            ConfigError: k is not 1 to 64.
        """
        _check_neighbours(k)
        squares, indices = np.empty((len(points), k)), np.empty((len(points), k), np.int32)
        engine.find_nearest(
            self.points, self.order, self.axes, len(self.points), np.ascontiguousarray(points),
            len(points), k, squares, indices,
        )  # fmt: skip
        return squares, indices

    def closest(self, points: FloatArray, within: float = math.inf) -> tuple[FloatArray, IntArray]:
        """Return distance (m,) [m] and index (m,) of the point of the tree closest to each point.

        Points (m, 2 or 3) with none closer than ``within`` [m] get infinity and the number of
        points of the tree.
        """
        distances, indices = np.empty(len(points)), np.empty(len(points), np.int64)
        engine.find_closest(
            self.points, self.order, self.axes, len(self.points), _make_spatial(points),
            len(points), within, distances, indices,
        )  # fmt: skip
        return distances, indices

    def is_near(self, points: FloatArray, within: float) -> BoolArray:
        """Return which ``points`` (m, 2 or 3) have a point of the tree ``within`` a distance [m].

        The search does not go farther, which is much quicker for points far away.
        """
        return np.asarray(self.closest(points, within * (1 + 1e-9))[0] <= within)

    def fit_planes(self, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fit a plane to the k nearest neighbours of each point of the tree, itself included.

        Returns:
            Centroids (n, 3) [m]; unit normals (n, 3) of either sign, the directions of least
            variance (Hoppe et al., SIGGRAPH 1992); and the two smaller variances (n, 2) [m2].

        Raises:
            ConfigError: k is not 1 to 64.
        """
        _check_neighbours(k)
        n = len(self.points)
        centroids, normals, variances = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 2))
        engine.fit_neighbourhoods(
            self.points, self.order, self.axes, n, k, centroids, normals, variances
        )
        return centroids, normals, variances


def _make_spatial(points: FloatArray) -> FloatArray:
    """Return ``points`` (n, 2 or 3) as (n, 3), those of a top view at z = 0."""
    if points.shape[1] == 3:
        return np.ascontiguousarray(points, np.float64)
    spatial = np.zeros((len(points), 3))
    spatial[:, :2] = points
    return spatial


def _check_neighbours(k: int) -> None:
    """Refuse a number of neighbours that the engine has no room for."""
    if not 1 <= k <= MAX_NEIGHBOURS:
        raise ConfigError(f"the number of neighbours must be 1 to {MAX_NEIGHBOURS}, got {k}")


def is_near(places: FloatArray, points: FloatArray, within: float) -> BoolArray:
    """Return whether each of ``places`` (m, 3) has one of ``points`` (n, 3) within a radius [m].

    ``native/near.h`` sorts the points into cubes, which is faster than a k-d tree for this.
    """
    near = np.empty(len(places), dtype=bool)
    places, points = np.ascontiguousarray(places), np.ascontiguousarray(points)
    if engine.find_near(points, len(points), places, len(places), within, near) < 0:
        raise MemoryError
    return near
