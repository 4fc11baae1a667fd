"""Planes as a lidar sees them: sheets with two sides, without end where their size is 0.

Neither caster does both alone: MuJoCo's rays pass the backs of planes, and Embree's triangles end.
Planes do not move (MuJoCo refuses them on moving bodies).
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.scenes.tessellation import PLANE_REACH


class Planes:
    """The planes of a model that a lidar sees."""

    def __init__(self, model: Any, seen: BoolArray) -> None:
        self._geoms = np.flatnonzero(seen & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE))
        if len(self._geoms) == 0:
            return
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self._places = np.array(data.geom_xpos[self._geoms])
        self._axes = np.array(data.geom_xmat[self._geoms]).reshape(-1, 3, 3)
        sizes = np.array(model.geom_size[self._geoms, :2])
        self._halves = np.where(sizes > 0, sizes, np.inf)

    def add_backs(
        self,
        origins: FloatArray,
        directions: FloatArray,
        hits: tuple[FloatArray, FloatArray, IntArray],
    ) -> None:
        """Add what rays hit from behind to ``hits``: distances, normals and geom ids, in place.

        Args:
            origins: (n, 3) [m].
            directions: Unit vectors (n, 3).
            hits: Distances (n,) [m], inf for a miss, normals (n, 3) and geom ids (n,).
        """
        for k in range(len(self._geoms)):
            behind = np.flatnonzero((origins - self._places[k]) @ self._axes[k][:, 2] < 0)
            if len(behind):
                self._add(k, behind, origins, directions, hits, 0.0)

    def add_far_parts(
        self,
        origins: FloatArray,
        directions: FloatArray,
        hits: tuple[FloatArray, FloatArray, IntArray],
    ) -> None:
        """Add what rays hit of endless planes beyond ``PLANE_REACH`` to ``hits``, in place.

        Arguments as for ``add_backs``.
        """
        extent = np.sqrt(3) * float(np.abs(origins).max(initial=0.0))
        for k in range(len(self._geoms)):
            if np.isfinite(self._halves[k]).all():
                continue
            nearest = PLANE_REACH - extent - float(np.linalg.norm(self._places[k]))
            far = np.flatnonzero(hits[0] > nearest)
            if len(far):
                self._add(k, far, origins, directions, hits, PLANE_REACH)

    def _add(
        self,
        plane: int,
        rays: IntArray,
        origins: FloatArray,
        directions: FloatArray,
        hits: tuple[FloatArray, FloatArray, IntArray],
        beyond: float,
    ) -> None:
        """Add what ``rays`` (m,) hit of a plane ``beyond`` a distance [m] from its middle."""
        # Intersect with the plane
        origin = (origins[rays] - self._places[plane]) @ self._axes[plane]
        direction = directions[rays] @ self._axes[plane]
        slope = np.where(direction[:, 2] == 0, np.nan, direction[:, 2])
        distances = -origin[:, 2] / slope

        # Keep what is on it and first
        at = np.abs(origin[:, :2] + distances[:, None] * direction[:, :2])
        half = self._halves[plane]
        endless = np.isinf(half)
        on = (at <= half).all(axis=1) & (distances > 0) & (distances < hits[0][rays])
        if beyond > 0:
            on &= (at[:, endless] > beyond).any(axis=1)
        chosen = rays[on]
        hits[0][chosen], hits[2][chosen] = distances[on], self._geoms[plane]
        hits[1][chosen] = self._axes[plane][:, 2]
