"""A static scene as triangles for Embree, by the optional package embreex."""

from __future__ import annotations

import importlib.util
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.tessellation import KNOWN, geom_triangles

_GEOM = mujoco.mjtGeom
_ROUND = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID, _GEOM.mjGEOM_CAPSULE)
_STRAIGHT = (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)


def available() -> bool:
    """Return whether Embree is installed; it is not for every processor."""
    return importlib.util.find_spec("embreex") is not None


def triangulated(model: Any) -> bool:
    """Return whether nothing in ``model`` moves and triangles can stand for all of it."""
    return model.nq == 0 and set(model.geom_type.tolist()) <= {int(kind) for kind in KNOWN}


def visible(model: Any, geom: int) -> bool:
    """Return whether rays see a geom: MuJoCo's pass through what is wholly transparent."""
    material = model.geom_matid[geom]
    alpha = model.geom_rgba[geom, 3]
    return bool(alpha > 0 and (material < 0 or model.mat_rgba[material, 3] > 0))


class Triangles:
    """The visible geoms of a static model as triangles in Embree; single precision.

    Arrays by triangle and by geom have one more entry, for a miss.
    """

    def __init__(self, model: Any) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        attitudes = np.array(data.geom_xmat).reshape(-1, 3, 3)
        parts, owners = [], []
        for geom in range(model.ngeom):
            if visible(model, geom):
                local = geom_triangles(model, geom)
                parts.append(local @ attitudes[geom].T + data.geom_xpos[geom])
                owners.append(np.full(len(local), geom))
        triangles = np.concatenate(parts)
        self.geoms: IntArray = np.append(np.concatenate(owners), -1)
        self.normals = np.vstack([_normals(triangles), np.zeros((1, 3))])
        self._shapes = Curved(model, np.array(data.geom_xpos), attitudes)
        self._bent = self._shapes.bent(self.geoms, self.normals)
        self._any_bent = bool(self._bent.any())
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, triangles.astype(np.float32))

    def run(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return distances (n,), inf for a miss, normals (n, 3) and geom ids (n,).

        Where a triangle stands for a curved surface, distance and normal are those of the surface.
        """
        found = self._scene.run(
            origins.astype(np.float32), directions.astype(np.float32), query="INTERSECT", output=1
        )
        index = found["primID"].astype(np.int64)
        distances = found["tfar"].astype(np.float64)
        distances[index < 0] = np.inf
        normals, geoms = self.normals.take(index, axis=0), self.geoms.take(index)
        if self._any_bent:
            bent = np.flatnonzero(self._bent.take(index))
            distances[bent], normals[bent] = self._shapes.refine(
                origins[bent], directions[bent], distances[bent], geoms[bent]
            )
        return distances, normals, geoms


class Curved:
    """The curved surfaces of a model: spheres, ellipsoids, cylinders, capsules."""

    def __init__(self, model: Any, places: FloatArray, attitudes: FloatArray) -> None:
        self._kinds = np.append(model.geom_type, -1)
        self._sizes = np.array(model.geom_size)
        self._places, self._attitudes = places, attitudes
        for geom, kind in enumerate(model.geom_type):
            if kind == _GEOM.mjGEOM_SPHERE:
                self._sizes[geom] = self._sizes[geom, 0]

    def bent(self, geoms: IntArray, normals: FloatArray) -> BoolArray:
        """Return which triangles (m,) with ``normals`` (m, 3) stand for a curved surface."""
        up = np.einsum("ni,ni->n", self._attitudes[geoms][:, :, 2], normals)
        side = (self._kinds[geoms] == _GEOM.mjGEOM_CYLINDER) & (np.abs(up) < 0.5)
        result: BoolArray = np.isin(self._kinds[geoms], [int(kind) for kind in _ROUND]) | side
        return result

    def refine(
        self, origins: FloatArray, directions: FloatArray, distances: FloatArray, geoms: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return exact distances (n,) and normals (n, 3) of rays that hit near ``distances``.

        All surfaces are |(p - centre) / scale| = 1, with an infinite scale along a cylinder.
        """
        attitudes = self._attitudes[geoms]
        origin = np.einsum("nji,nj->ni", attitudes, origins - self._places[geoms])
        along = np.einsum("nji,nj->ni", attitudes, directions)
        scale = self._sizes[geoms]
        straight = np.isin(self._kinds[geoms], [int(kind) for kind in _STRAIGHT])
        end = np.where(self._kinds[geoms] == _GEOM.mjGEOM_CAPSULE, scale[:, 1], np.inf)
        height = origin[:, 2] + distances * along[:, 2]
        capped = straight & (np.abs(height) > end)
        origin[capped, 2] -= np.copysign(end, height)[capped]
        scale[straight] = scale[straight, :1]
        scale[straight & ~capped, 2] = np.inf
        u, v = origin / scale, along / scale
        a, b, c = (np.einsum("ni,ni->n", p, q) for p, q in ((v, v), (u, v), (u, u)))
        root = np.sqrt(np.maximum(b * b - a * (c - 1.0), 0.0))
        near, far = (-b - root) / a, (-b + root) / a
        exact = np.where(np.abs(near - distances) <= np.abs(far - distances), near, far)
        normals = (u + exact[:, None] * v) / scale
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return exact, np.einsum("nij,nj->ni", attitudes, normals)


def _normals(triangles: FloatArray) -> FloatArray:
    """Return the unit normals (m, 3) of ``triangles`` (m, 3, 3)."""
    a, b, c = (triangles[:, k] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    result: FloatArray = normals / np.maximum(length, 1e-300)
    return result
