"""Faces of different geoms at the same place: which of them a ray hits, in both casters alike.

Where a box stands on a plane or touches another box, both faces are the first hit of a ray from
within; where it is let flush into a wall, of any ray. Left alone, rounding decides, otherwise in
each caster. The rule instead: planes come before boxes, these before cylinders, these before
meshes, and among alike geoms the first of the file. Two meshes are left to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.scenes.tessellation import mesh_triangles

SAME_PLACE = 1e-5
"""Distance within which faces coincide [m]: the rounding of Embree's single precision at 50 m."""
PARALLEL = 1 - 1e-9
"""Least cosine between the normals of coinciding faces: they part by 5e-5 m in 1 m."""
FAR = 1e6
"""Half the side of an endless plane's bounding box [m]."""

_GEOM = mujoco.mjtGeom
_SIDES = {
    _GEOM.mjGEOM_PLANE: ((2, 1.0),),
    _GEOM.mjGEOM_BOX: tuple((axis, sign) for axis in range(3) for sign in (1.0, -1.0)),
    _GEOM.mjGEOM_CYLINDER: ((2, 1.0), (2, -1.0)),
}
"""Axis and sign of the outward normals of the flat faces of a geom, by its type, in order."""


@dataclass(frozen=True)
class _Face:
    """A flat face of a geom.

    Attributes:
        geom: Id of the geom.
        middle: (3,) [m].
        axes: Two unit vectors along the face and its outward normal, as columns (3, 3).
        halves: Half the sides along the first two [m] (2,); inf without end.
        is_round: Whether it is the disc of radius ``halves[0]``.
    """

    geom: int
    middle: FloatArray
    axes: FloatArray
    halves: FloatArray
    is_round: bool

    def contains(self, points: FloatArray) -> BoolArray:
        """Return which of ``points`` (n, 3) [m] lie on the face."""
        local = (points - self.middle) @ self.axes
        flat = np.abs(local[:, 2]) <= SAME_PLACE
        if self.is_round:
            return np.asarray(flat & (np.hypot(local[:, 0], local[:, 1]) <= self.halves[0]))
        return np.asarray(flat & (np.abs(local[:, :2]) <= self.halves + SAME_PLACE).all(axis=1))

    def does_meet(self, other: _Face) -> bool:
        """Return whether the ``other`` face, in the same plane, covers a part of this one."""
        between = other.middle - self.middle
        for face in (self, other):  # two rectangles: by the theorem of separating axes
            along = face.axes[:, :2]
            reach = sum(np.abs(along.T @ each.sides()).sum(axis=1) for each in (self, other))
            if (np.abs(between @ along) >= reach - SAME_PLACE).any():
                return False
        return True

    def does_touch(self, triangles: FloatArray) -> bool:
        """Return whether one of ``triangles`` (m, 3, 3) [m] may lie on the face."""
        heights = (triangles - self.middle) @ self.axes[:, 2]
        if heights.min() > SAME_PLACE or heights.max() < -SAME_PLACE:
            return False
        flat = triangles[np.abs(heights).max(axis=1) <= SAME_PLACE]
        local = (flat - self.middle) @ self.axes[:, :2]
        near = (local.min(axis=1) <= self.halves) & (local.max(axis=1) >= -self.halves)
        return bool(near.all(axis=1).any())

    def sides(self) -> FloatArray:
        """Return the vectors from the middle to both sides, as columns (3, 2) [m]."""
        sides: FloatArray = self.axes[:, :2] * np.minimum(self.halves, FAR)
        return sides


class CoincidingFaces:
    """The flat faces of a still model on which faces of other geoms lie."""

    def __init__(self, model: Any, seen: BoolArray) -> None:
        """Find those of the ``seen`` geoms (n_geoms,); none in a model that moves."""
        self._faces: list[tuple[_Face, BoolArray]] = []
        self._normals: list[FloatArray] = []
        self._concerned = np.zeros(model.ngeom + 1, bool)
        if model.nq > 0:
            return
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        kinds = np.where(seen, model.geom_type, -1)
        flat = [
            face
            for kind in _SIDES
            for geom in np.flatnonzero(kinds == kind).tolist()
            for face in _flat_faces(model, data, geom)
        ]
        meshes = {
            geom: mesh_triangles(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T
            + data.geom_xpos[geom]
            for geom in np.flatnonzero(kinds == _GEOM.mjGEOM_MESH).tolist()
        }

        # Find what comes after each face and lies on it
        found: dict[int, list[FloatArray]] = {}
        covers = _find_covers(flat)
        for face, others in zip(flat, covers, strict=True):
            on = [(other.geom, other.axes[:, 2]) for other in others]
            for geom in (geom for geom, parts in meshes.items() if face.does_touch(parts)):
                on += [(geom, face.axes[:, 2]), (geom, -face.axes[:, 2])]
            later = np.zeros(model.ngeom + 1, bool)  # the last is for a miss
            for geom, normal in on:
                later[geom] = True
                found.setdefault(geom, []).append(normal)
            if on:
                self._faces.append((face, later))
        self._faces.reverse()  # the first has the last word
        self._normals = _tabulate(found, model.ngeom)
        self._concerned[list(found)] = True

    def face_alike(self, normals: FloatArray, geoms: IntArray) -> BoolArray:
        """Return which surfaces of ``geoms`` (n,) have the normal of such a face (n,).

        Args:
            normals: Of the surfaces, unit vectors (n, 3).
            geoms: Geom ids; -1 for none.
        """
        near = np.flatnonzero(self._concerned.take(geoms))
        own, facing, alike = geoms[near], normals[near], np.zeros(len(near), bool)
        for table in self._normals:
            alike |= np.einsum("ni,ni->n", table.take(own, axis=0), facing) >= PARALLEL
        result = np.zeros(len(geoms), bool)
        result[near] = alike
        return result

    def settle(
        self,
        origins: FloatArray,
        directions: FloatArray,
        hits: tuple[FloatArray, FloatArray, IntArray],
        alike: BoolArray,
    ) -> None:
        """Let ``hits`` on coinciding faces be of the geom that comes first, in place.

        Args:
            origins: (n, 3) [m].
            directions: Unit vectors (n, 3).
            hits: Distances (n,) [m], inf for a miss, normals (n, 3) and geom ids (n,).
            alike: Which of them ``face_alike`` chooses (n,).
        """
        distances, normals, geoms = hits
        rays = np.flatnonzero(alike)
        if len(rays) == 0:
            return
        points = origins[rays] + distances[rays, None] * directions[rays]
        for face, later in self._faces:
            on = later.take(geoms[rays]) & face.contains(points)
            geoms[rays[on]], normals[rays[on]] = face.geom, face.axes[:, 2]


def _find_covers(faces: Sequence[_Face]) -> list[list[_Face]]:
    """Return for each of ``faces`` those after it, of other geoms, that cover a part of it."""
    normals = np.array([face.axes[:, 2] for face in faces]).reshape(-1, 3)
    middles = np.array([face.middle for face in faces]).reshape(-1, 3)
    radii = np.array([float(np.hypot(*face.halves)) for face in faces])
    covers = []
    for number, face in enumerate(faces):
        # Keep those in the same plane, whichever side they show
        after, normal = slice(number + 1, None), face.axes[:, 2]
        level = np.abs(middles[after] @ normal - face.middle @ normal) <= SAME_PLACE
        level &= np.abs(normals[after] @ normal) >= PARALLEL
        others = number + 1 + np.flatnonzero(level)

        # Keep those that overlap
        apart = np.linalg.norm(middles[others] - face.middle, axis=1)
        near = [faces[k] for k in others[apart < radii[others] + radii[number]]]
        covers.append([each for each in near if each.geom != face.geom and face.does_meet(each)])
    return covers


def _tabulate(normals: Mapping[int, list[FloatArray]], n_geoms: int) -> list[FloatArray]:
    """Return ``normals`` by geom as tables (n_geoms + 1, 3), as many as a geom has different ones.

    The rows of geoms without are 0.
    """
    tables: list[FloatArray] = []
    for geom, found in normals.items():
        for slot, normal in enumerate(np.unique(np.round(found, 12), axis=0)):
            if slot == len(tables):
                tables.append(np.zeros((n_geoms + 1, 3)))
            tables[slot][geom] = normal
    return tables


def _flat_faces(model: Any, data: Any, geom: int) -> list[_Face]:
    """Return the flat faces of a plane, box or cylinder, in ``map``."""
    kind = _GEOM(int(model.geom_type[geom]))
    place, turn = np.array(data.geom_xpos[geom]), np.array(data.geom_xmat[geom]).reshape(3, 3)
    extent = np.array(model.geom_size[geom])
    if kind == _GEOM.mjGEOM_PLANE:
        extent = np.array([*np.where(extent[:2] > 0, extent[:2], np.inf), 0.0])
    elif kind == _GEOM.mjGEOM_CYLINDER:
        extent = extent[[0, 0, 1]]
    faces = []
    for axis, sign in _SIDES[kind]:
        along = [(axis + 1) % 3, (axis + 2) % 3]
        axes = turn[:, [*along, axis]] * (1.0, 1.0, sign)
        middle = place + extent[axis] * axes[:, 2]
        faces.append(_Face(geom, middle, axes, extent[along], kind == _GEOM.mjGEOM_CYLINDER))
    return faces
