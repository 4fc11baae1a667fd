"""Distances to a surface that is known by samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Surface:
    """A surface by samples, each of which represents a small flat patch.

    Attributes:
        points: The samples (n, 3) [m].
        normals: Their unit normals (n, 3).
        spacing: Their spacing [m].
        tree: Search tree over ``points``.
    """

    points: FloatArray
    normals: FloatArray
    spacing: float
    tree: Tree

    @staticmethod
    def of(points: FloatArray, normals: FloatArray, spacing: float) -> Surface:
        """Return the surface of these samples."""
        return Surface(points, normals, spacing, Tree.of(points))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (m,) [m] of ``points`` (m, 3) to the nearest samples' patches.

        The patches are flat, so that the sampling adds no distance of its own.
        """
        _, index = self.tree.closest(points)
        return self._off(points, index)

    def within(self, points: FloatArray, distance: float) -> BoolArray:
        """Return which ``points`` (m, 3) are no farther away than ``distance`` [m].

        Samples whose patches cannot be within reach are not searched for, which is quicker.
        """
        reach = (distance + self.spacing / np.sqrt(2)) * (1 + 1e-9)
        found, index = self.tree.closest(points, reach)
        near = np.isfinite(found)
        near[near] = self._off(points[near], index[near]) <= distance
        return near

    def _off(self, points: FloatArray, index: IntArray) -> FloatArray:
        """Return the distance (m,) [m] of ``points`` (m, 3) to the patches ``index`` (m,)."""
        offset, normals = points - self.points[index], self.normals[index]
        along = np.sum(offset * normals, axis=1)
        across = np.linalg.norm(offset - along[:, None] * normals, axis=1)
        beside = np.maximum(0.0, across - self.spacing / np.sqrt(2))
        return np.asarray(np.hypot(along, beside))


def measure_surface_distance(
    points: FloatArray, surface: FloatArray, normals: FloatArray, spacing: float
) -> FloatArray:
    """Return the distance (n,) [m] of ``points`` (n, 3) to a surface sampled every ``spacing`` [m].

    ``Surface`` answers repeated queries faster.
    """
    return Surface.of(surface, normals, spacing).distance(points)
