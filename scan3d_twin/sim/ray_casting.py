"""Ray casting against a scene, each ray with its own origin.

What rays hit is what a lidar sees, by the rule of ``scenes/visibility.py``, in both casters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from mujoco import batch

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.coinciding_faces import CoincidingFaces
from scan3d_twin.sim.embree import MAX_HEIGHTS, TriangleScene, can_triangulate, is_available
from scan3d_twin.sim.planes import Planes
from scan3d_twin.sim.scenes.visibility import find_seen_geoms, model_as_seen

EMBREE_MIN_GEOMS = 8
"""Fewest geoms for which Embree is faster; measured: 8 geoms 1.8 times, 109 geoms 10 times."""
EMBREE_MIN_TRIANGLES = 2000
"""Fewest triangles of all meshes and height fields for which Embree is faster."""

EMBREE_MANY_TRIANGLES = 20_000
"""Fewest triangles of all meshes for which a million of MuJoCo's exact rays take too long: with
400,000 (a Unitree G1) a minute."""


@dataclass(frozen=True, slots=True)
class Hits:
    """The first hits of rays.

    Attributes:
        distances: Distances (n,) [m]; inf for a miss.
        normals: Unit outward normals (n, 3), exact for primitives; of meshes as their faces are
            wound; 0 for a miss.
        geoms: Geom ids in the caster's model (n,); -1 for a miss.
    """

    distances: FloatArray
    normals: FloatArray
    geoms: IntArray


class RayCaster(Protocol):
    """Casts rays against the scene without the robot."""

    def cast(self, qpos: FloatArray, origins: FloatArray, directions: FloatArray) -> Hits:
        """Return the first hits.

        Args:
            qpos: Positions of the scene's moving objects (nq,); empty for a static scene.
            origins: (n, 3) [m].
            directions: Unit vectors (n, 3).
        """
        ...


def choose_caster(model: Any) -> RayCaster:
    """Return the faster ray caster for ``model``.

    Embree, where it is installed, for static scenes with many geoms or large meshes; else MuJoCo.
    """
    return EmbreeCaster(model) if model.nq == 0 and _suits_embree(model) else MujocoCaster(model)


def choose_caster_of(model: Any, seen: BoolArray) -> RayCaster:
    """Return the caster for many rays at the ``seen`` geoms of ``model`` in its reference pose."""
    crowded = model.nmeshface >= EMBREE_MANY_TRIANGLES and _suits_embree(model)
    return EmbreeCaster(model, seen=seen) if crowded else MujocoCaster(model, seen)


def choose_patient_caster(model: Any) -> RayCaster:
    """Return the caster for many rays at a time against a ``model`` that stands still meanwhile."""
    return PosedCaster(model) if model.nq > 0 and _suits_embree(model) else MujocoCaster(model)


def _suits_embree(model: Any) -> bool:
    """Return whether Embree can cast rays against ``model`` at rest, and would be faster."""
    triangles = model.nmeshface + 2 * model.nhfielddata
    large = model.ngeom >= EMBREE_MIN_GEOMS or triangles >= EMBREE_MIN_TRIANGLES
    return bool(large and is_available() and can_triangulate(model))


class MujocoCaster:
    """The reference: exact primitives, mesh triangles, moving objects.

    Its cost grows with the number of geoms. The model does not contain the robot: what the lidar
    sees of it is constant and added by the lidar. Height fields, which do not move and take MuJoCo
    40 us a ray, are left to Embree where it is installed.
    """

    def __init__(self, model: Any, seen: BoolArray | None = None) -> None:
        """Cast rays against what is ``seen`` of ``model`` (n_geoms,), by default by the rule."""
        seen = find_seen_geoms(model) if seen is None else seen
        fields = seen & (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
        self._fields: TriangleScene | None = None
        if fields.any() and is_available() and model.nhfielddata <= MAX_HEIGHTS:
            self._fields, seen = TriangleScene(model, fields), seen & ~fields
        self._batch = batch.Batch(model_as_seen(model, seen), nsim=1, nthread=1)
        self._qpos = self._batch.bind("qpos")
        self._planes = Planes(model, seen)
        self._coinciding = CoincidingFaces(model, seen)

    def cast(self, qpos: FloatArray, origins: FloatArray, directions: FloatArray) -> Hits:
        """See ``RayCaster.cast``."""
        self._qpos[0] = qpos
        distances, geoms, normals = self._batch.ray(origins, directions, normal=True)
        missed = geoms[0] < 0
        hits = np.where(missed, np.inf, distances[0]), normals[0], geoms[0].astype(np.int64)
        if self._fields is not None:
            _add_nearer(self._fields.run(origins, directions)[:3], hits)
        self._planes.add_backs(origins, directions, hits)
        alike = self._coinciding.face_alike(*hits[1:])
        self._coinciding.settle(origins, directions, hits, alike)
        return Hits(*hits)


class EmbreeCaster:
    """A bounding volume hierarchy of triangles: a hundred objects take hardly more time than one.

    Static scenes only, single precision. Curved primitives are tessellated, but hits on them get
    the exact distance and normal: flat facets of a shiny surface would return light in bands.
    """

    def __init__(
        self, model: Any, qpos: FloatArray | None = None, seen: BoolArray | None = None
    ) -> None:
        """Cast rays against what is ``seen`` of ``model`` at ``qpos`` (nq,), see ``MujocoCaster``.

        By default what is seen by the rule, and at the reference pose.
        """
        seen = find_seen_geoms(model) if seen is None else seen
        self._triangles = TriangleScene(model, seen, qpos)
        self._planes = Planes(model, seen)
        self._coinciding = CoincidingFaces(model, seen)
        self._alike = self._coinciding.face_alike(self._triangles.normals, self._triangles.geoms)

    def cast(self, qpos: FloatArray, origins: FloatArray, directions: FloatArray) -> Hits:
        """See ``RayCaster.cast``."""
        # Cast for the first triangles, and planes beyond them
        distances, normals, geoms, triangles = self._triangles.run(origins, directions)
        hits = distances, normals, geoms
        self._planes.add_far_parts(origins, directions, hits)

        # Settle hits on coinciding faces
        alike = self._alike.take(triangles)
        beyond = np.flatnonzero(geoms != self._triangles.geoms.take(triangles))
        alike[beyond] = self._coinciding.face_alike(normals[beyond], geoms[beyond])
        self._coinciding.settle(origins, directions, hits, alike)
        return Hits(*hits)


class PosedCaster:
    """Embree for a scene that moves, tessellated again whenever it has moved."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._qpos = np.array(model.qpos0)
        self._caster = EmbreeCaster(model, self._qpos)

    def cast(self, qpos: FloatArray, origins: FloatArray, directions: FloatArray) -> Hits:
        """See ``RayCaster.cast``."""
        if not np.array_equal(qpos, self._qpos):
            self._qpos = np.array(qpos)
            self._caster = EmbreeCaster(self._model, self._qpos)
        return self._caster.cast(qpos, origins, directions)


def _add_nearer(
    found: tuple[FloatArray, FloatArray, IntArray], hits: tuple[FloatArray, FloatArray, IntArray]
) -> None:
    """Put what was ``found`` nearer than ``hits`` into these: distances, normals and geom ids."""
    nearer = found[0] < hits[0]
    for own, other in zip(hits, found, strict=True):
        own[nearer] = other[nearer]
