"""A still scene as triangles for Embree, by the optional package embreex."""

from __future__ import annotations

import importlib.util
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.scenes.tessellation import TRIANGULATED_TYPES, geom_triangles

MAX_HEIGHTS = 1_000_000
"""Most heights of all height fields that are tessellated: 0.6 GB in Embree."""


@contextmanager
def lifted_memory_limit() -> Iterator[None]:
    """Let Embree take its memory, which grows with the triangles: where it lacks it crashes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


_GEOM = mujoco.mjtGeom
_ROUND = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID)
_STRAIGHT = (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)


def is_available() -> bool:
    """Return whether Embree is installed; it is not for every processor."""
    return importlib.util.find_spec("embreex") is not None


def can_triangulate(model: Any) -> bool:
    """Return whether all geoms of ``model`` can be tessellated within reasonable memory."""
    known = {int(kind) for kind in TRIANGULATED_TYPES}
    return set(model.geom_type.tolist()) <= known and model.nhfielddata <= MAX_HEIGHTS


class TriangleScene:
    """The ``seen`` geoms of a model that stands still as triangles in Embree; single precision.

    Arrays by triangle have one more entry, for a miss.
    """

    def __init__(self, model: Any, seen: BoolArray, qpos: FloatArray | None = None) -> None:
        """Tessellate ``model`` at ``qpos`` (nq,), by default its reference pose."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # Compute the poses of all geoms
        data = mujoco.MjData(model)
        if qpos is not None:
            data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        attitudes = np.array(data.geom_xmat).reshape(-1, 3, 3)

        # Tessellate the seen geoms
        parts, owners, shapes = [], [], []
        for geom in np.flatnonzero(seen).tolist():
            local = geom_triangles(model, geom)
            parts.append(local @ attitudes[geom].T + data.geom_xpos[geom])
            owners.append(np.full(len(local), geom))
            shapes.append(_shapes(model, geom, local))

        # Build the arrays by triangle
        triangles = np.concatenate(parts)
        self.geoms: IntArray = np.append(np.concatenate(owners), -1)
        self.normals = np.vstack([_normals(triangles), np.zeros((1, 3))])
        # Four shapes per geom: flat, side, lower and upper end; flat ones are not refined.
        self._shapes = np.append(np.concatenate(shapes), 0)
        self._shapes[:-1] += 4 * self.geoms[:-1]
        self._curved = np.append(np.concatenate(shapes) > 0, False)
        self._any_curved = bool(self._curved.any())
        self._maps, self._offsets = _quadrics(model, np.array(data.geom_xpos), attitudes)

        # Build the hierarchy of triangles, which Embree does at the first rays
        with lifted_memory_limit():
            self._scene = EmbreeScene(robust=True)
            self._mesh = TriangleMesh(self._scene, triangles.astype(np.float32))
            self.run(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))

    def run(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
        """Return distances (n,), inf for a miss, normals (n, 3), geom ids and triangles (n,).

        Hits on a tessellated curved surface are refined to its exact distance and normal.
        """
        # Cast for the first hits
        found = self._scene.run(
            origins.astype(np.float32), directions.astype(np.float32), query="INTERSECT", output=1
        )
        index = found["primID"].astype(np.int64)
        distances = found["tfar"].astype(np.float64)
        distances[index < 0] = np.inf

        # Look up normals and geoms
        normals, geoms = self.normals.take(index, axis=0), self.geoms.take(index)

        # Refine hits on curved surfaces
        if self._any_curved:
            curved = np.flatnonzero(self._curved.take(index))
            if len(curved):
                distances[curved], normals[curved] = self._refine(
                    self._shapes.take(index[curved]),
                    origins[curved],
                    directions[curved],
                    distances[curved],
                )
        return distances, normals, geoms, index

    def _refine(
        self, shapes: IntArray, origins: FloatArray, directions: FloatArray, distances: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return exact distances (n,) and normals (n, 3) of rays that hit near ``distances``.

        A curved surface is |M p - m| = 1.
        """
        maps = self._maps.take(shapes, axis=0)
        u = np.einsum("nij,nj->ni", maps, origins) - self._offsets.take(shapes, axis=0)
        v = np.einsum("nij,nj->ni", maps, directions)
        a, b, c = (np.einsum("ni,ni->n", p, q) for p, q in ((v, v), (u, v), (u, u)))
        root = np.sqrt(np.maximum(b * b - a * (c - 1.0), 0.0))
        near, far = (-b - root) / a, (root - b) / a
        exact = np.where(np.abs(near - distances) <= np.abs(far - distances), near, far)
        normals = np.einsum("nij,ni->nj", maps, u + exact[:, None] * v)
        normals /= np.sqrt(np.einsum("ni,ni->n", normals, normals))[:, None]
        return exact, normals


def _shapes(model: Any, geom: int, triangles: FloatArray) -> IntArray:
    """Return the surface of each of a geom's ``triangles`` (m, 3, 3): 0 flat, 1 side, 2, 3 ends."""
    kind, half = int(model.geom_type[geom]), model.geom_size[geom, 1]
    height = triangles[:, :, 2].mean(axis=1)
    if kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID):
        return np.ones(len(triangles), np.int64)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return np.where(np.abs(height) < half * (1 - 1e-9), 1, 0)
    if kind == _GEOM.mjGEOM_CAPSULE:
        return np.where(height < -half, 2, np.where(height > half, 3, 1))
    return np.zeros(len(triangles), np.int64)


def _quadrics(
    model: Any, places: FloatArray, attitudes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return M (4 n_geoms, 3, 3) [1/m] and m (4 n_geoms, 3) of the shapes of all geoms."""
    maps, offsets = np.zeros((model.ngeom, 4, 3, 3)), np.zeros((model.ngeom, 4, 3))
    for geom, kind in enumerate(model.geom_type.tolist()):
        radius, half = model.geom_size[geom, :2]
        if kind not in _ROUND and kind not in _STRAIGHT:
            continue

        # Choose the radii by kind
        side, ends = np.full(3, radius), 0.0
        if kind == _GEOM.mjGEOM_ELLIPSOID:
            side = np.array(model.geom_size[geom])
        elif kind in _STRAIGHT:
            side, ends = np.array([radius, radius, np.inf]), half

        # Map side and both ends
        for shape, (size, along) in enumerate(((side, 0.0), (radius, -ends), (radius, ends)), 1):
            maps[geom, shape] = (attitudes[geom] / size).T
            centre = places[geom] + along * attitudes[geom][:, 2]
            offsets[geom, shape] = maps[geom, shape] @ centre
    return maps.reshape(-1, 3, 3), offsets.reshape(-1, 3)


def _normals(triangles: FloatArray) -> FloatArray:
    """Return the unit normals (m, 3) of ``triangles`` (m, 3, 3)."""
    a, b, c = (triangles[:, k] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    result: FloatArray = normals / np.maximum(length, 1e-300)
    return result
