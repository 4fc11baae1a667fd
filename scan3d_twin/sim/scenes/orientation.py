"""Which side of a mesh's faces can be seen, decided by rays from outside and not by their winding.

After K. Takayama, A. Jacobson, L. Kavan, O. Sorkine-Hornung, "A Simple Method for Correcting Facet
Orientations in Polygon Meshes Based on Ray Casting", JCGT 3(4), 2014: faces that meet at ordinary
edges form patches, whose orientation is one decision; rays from samples on both sides of a patch
make it, by how many leave the object. Beyond that, the floor blocks rays as well, the robot's
start is one of the places that may be seen, and a patch with a border whose both sides see the
outside is a sheet with two sides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2
from scan3d_twin.sim.ray_casting import RayCaster, choose_caster_of
from scan3d_twin.sim.scenes.facing import Facing, turn_over
from scan3d_twin.sim.scenes.surface_samples import bounding_points, sample_places
from scan3d_twin.sim.scenes.tessellation import mesh_triangles_by_number
from scan3d_twin.sim.scenes.visibility import GROUNDS, find_seen_geoms

WELD = 2.0**-20
"""Distance within which vertices are one, in units of the mesh's extent: above the rounding of
single precision (2^-24)."""
SAMPLES = 1000
"""Samples on a mesh, by area, besides one for each patch (assumption)."""
DIRECTIONS, LEAST_DIRECTIONS = 24, 6
"""Directions of the rays from each side of a sample, and the fewest on a mesh of many patches."""
MAX_RAYS, MAX_PATCHES = 1_000_000, 50_000
"""Most rays for one mesh, half a second, and most patches that get a sample of their own, the
largest; smaller ones face away from the middle of the mesh."""
MAX_INCIDENCE = np.radians(80.0)
"""Largest angle of a ray to the normal [rad]; farther aslant a surface is not visible
(``core.model.coverable.MIN_COSINE``)."""
START_OFFSET = 2e-5
"""Distance of a ray's start from its face [m]: less than a sheet is thick, more than rounding."""
MARGIN = 0.05
"""Distance from the object at which a ray has left it [m]: beyond the gap below a thing that does
not quite reach the floor (assumption)."""
MIN_BACK_SHARE = 0.05
"""Share of the rays leaving the front above which the back of a patch with a border is seen as
well: less is a hole in a closed surface (assumption)."""


@dataclass(frozen=True)
class Outside:
    """What rays from a mesh meet, and where they are outside.

    Attributes:
        caster: Casts rays against the object that the mesh is part of, and the floor.
        qpos: Positions of the scene's moving objects.
        box: Low and high corner (3,) of the object with a margin [m]: rays beyond have left it.
        eye: Place of the lidar at the robot's start (3,) [m].
    """

    caster: RayCaster
    qpos: FloatArray
    box: tuple[FloatArray, FloatArray]
    eye: FloatArray


def find_facings(
    model: Any, targets: Mapping[str, tuple[str, ...]], spawn: Pose2
) -> dict[str, Facing]:
    """Return which sides of the faces of each mesh geom of the ``targets`` can be seen, by name.

    Args:
        model: The compiled scene.
        targets: Names of the geoms of each target.
        spawn: The robot's start.
    """
    # Leave scenes without meshes alone
    kinds = {name: model.geom(name).type[0] for parts in targets.values() for name in parts}
    if mujoco.mjtGeom.mjGEOM_MESH not in kinds.values():
        return {}
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eye = np.array([spawn.x, spawn.y, LIDAR_HEIGHT])

    # Decide for each object, with the floor but without its surroundings
    result = {}
    for parts in targets.values():
        meshes = [name for name in parts if kinds[name] == mujoco.mjtGeom.mjGEOM_MESH]
        if not meshes:
            continue
        seen = find_seen_geoms(model) & np.isin(model.geom_type, GROUNDS)
        seen[[model.geom(name).id for name in parts]] = True
        corners = np.concatenate([_place(data, name, bounding_points) for name in parts])
        box = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
        outside = Outside(choose_caster_of(model, seen), np.array(data.qpos), box, eye)
        for name in meshes:
            triangles = _place(data, name, mesh_triangles_by_number)
            result[name] = find_facing(triangles, outside)
    return result


def _place(data: Any, name: str, shape: Callable[[Any, int], FloatArray]) -> FloatArray:
    """Return the ``shape`` of a geom (..., 3) in ``map`` [m]."""
    geom = data.geom(name)
    placed: FloatArray = shape(data.model, geom.id) @ geom.xmat.reshape(3, 3).T + geom.xpos
    return placed


def find_facing(triangles: FloatArray, outside: Outside) -> Facing:
    """Return which sides of ``triangles`` (m, 3, 3) in ``map`` can be seen from ``outside``."""
    # Wind faces by the places of their corners, so that nothing below depends on the file
    faces = weld(triangles)
    turned = faces[:, 1] > faces[:, 2]
    faces[turned] = faces[turned][:, [0, 2, 1]]
    triangles = np.where(turned[:, None, None], turn_over(triangles), triangles)
    repeated = _find_repeated(faces)

    # Join faces to patches of one orientation
    patches, reversed_, closed = find_patches(faces, repeated)
    wound = np.where(reversed_[:, None, None], turn_over(triangles), triangles)

    # Count the rays that leave, by side
    front, back = _count_leaving(wound, patches, repeated, outside)
    tie = (front == 0) & (back == 0)
    middle = (triangles.min(axis=(0, 1)) + triangles.max(axis=(0, 1))) / 2
    outwards = _sum_outwards(wound, patches, middle, len(front))
    inwards = np.where(tie, outwards < 0, back > front)
    most, least = np.maximum(front, back), np.minimum(front, back)
    sheet = ~closed & (least > MIN_BACK_SHARE * most)
    return Facing(turned ^ reversed_ ^ inwards[patches], sheet[patches], repeated)


def weld(triangles: FloatArray) -> IntArray:
    """Return the faces (m, 3) of ``triangles`` (m, 3, 3) whose vertices at one place are one."""
    points = triangles.reshape(-1, 3)
    low = points.min(axis=0)
    step = float((points.max(axis=0) - low).max()) * WELD
    cells = np.rint((points - low) / max(step, 1e-300)).astype(np.int64)
    keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
    _, index = np.unique(keys, return_inverse=True)
    return np.asarray(index.reshape(-1, 3), dtype=np.int64)


def find_patches(faces: IntArray, skipped: BoolArray) -> tuple[IntArray, BoolArray, BoolArray]:
    """Return patches of ``faces`` (m, 3) that meet at edges of two faces.

    Args:
        faces: Indices of vertices.
        skipped: Faces that join nothing (m,).

    Returns:
        The patch of each face (m,), whether the face is wound against the first one of its
        patch (m,), and whether a patch is closed: oriented and without a border (n_patches,).
    """
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    # Sort the edges of all faces
    m = len(faces)
    owner = np.tile(np.arange(m), 3)
    a, b = faces.T.ravel(), np.roll(faces, -1, axis=1).T.ravel()
    real = (a != b) & ~skipped[owner]
    owner, a, b = owner[real], a[real], b[real]
    order = np.lexsort((np.maximum(a, b), np.minimum(a, b)))
    owner, a, b = owner[order], a[order], b[order]
    low, high = np.minimum(a, b), np.maximum(a, b)
    first = np.flatnonzero(np.r_[True, (low[1:] != low[:-1]) | (high[1:] != high[:-1])])
    count = np.diff(np.r_[first, len(low)])

    # Join faces, each in both windings
    pair = first[count == 2]
    f, g, against = owner[pair], owner[pair + 1], a[pair] == a[pair + 1]
    rows = np.concatenate([f, f + m])
    columns = np.concatenate([g + m * against, g + m * ~against])
    graph = coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(2 * m, 2 * m))
    labels = connected_components(graph, directed=False)[1]
    either = np.minimum(labels[:m], labels[m:])
    _, head, patches = np.unique(either, return_index=True, return_inverse=True)

    # Find borders and surfaces of one side only
    closed = labels[head] != labels[head + m]
    borders = owner[np.repeat(count != 2, count)]
    closed[patches[borders]] = False
    return patches, labels[:m] != labels[:m][head][patches], closed


def is_closed(triangles: FloatArray) -> bool:
    """Return whether ``triangles`` (m, 3, 3) have no border, so that rays enter and leave."""
    faces = weld(triangles)
    return bool(find_patches(faces, np.zeros(len(faces), bool))[2].all())


def _find_repeated(faces: IntArray) -> BoolArray:
    """Return which ``faces`` (m, 3) have the vertices of an earlier one (m,)."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    repeated = np.ones(len(faces), bool)
    repeated[first] = False
    return repeated


def _count_leaving(
    triangles: FloatArray, patches: IntArray, skipped: BoolArray, outside: Outside
) -> tuple[FloatArray, FloatArray]:
    """Return the share of rays that leave the front and the back of each patch (n_patches,)."""
    # Choose samples by area, and one for each patch
    n_patches = int(patches.max()) + 1
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    kept = np.flatnonzero(~skipped & (double_area > 0))
    points, owners = sample_places(triangles[kept], SAMPLES)
    heads = _find_largest(double_area, patches, kept)
    points = np.concatenate([points, triangles[heads].mean(axis=1)])
    chosen = np.concatenate([kept[owners], heads])
    normals = cross[chosen] / double_area[chosen, None]

    # Cast rays from both sides
    per_side = int(np.clip(MAX_RAYS // (2 * len(points)), LEAST_DIRECTIONS, DIRECTIONS))
    shares = []
    for sign in (1.0, -1.0):
        leaves = _measure_openness(points, sign * normals, per_side, outside)
        total = np.bincount(patches[chosen], leaves, n_patches)
        shares.append(total / np.maximum(np.bincount(patches[chosen], minlength=n_patches), 1))
    return shares[0], shares[1]


def _find_largest(areas: FloatArray, patches: IntArray, kept: IntArray) -> IntArray:
    """Return the largest of the ``kept`` faces of each patch, of at most ``MAX_PATCHES``."""
    by_area = kept[np.argsort(-areas[kept], kind="stable")]
    _, first = np.unique(patches[by_area], return_index=True)
    return by_area[np.sort(first)[:MAX_PATCHES]]


def _measure_openness(
    points: FloatArray, normals: FloatArray, count: int, outside: Outside
) -> FloatArray:
    """Return the share of ``count`` rays from each of ``points`` (n, 3) that get outside."""
    # Cast rays about the normal
    starts = points + START_OFFSET * normals
    directions = _spread_directions(normals, count).reshape(-1, 3)
    origins = np.repeat(starts, count, axis=0)
    hits = outside.caster.cast(outside.qpos, origins, directions).distances
    out = (hits > _exit_distances(origins, directions, outside.box)).reshape(-1, count)

    # Look at the robot's start
    rays = outside.eye - starts
    reach = np.linalg.norm(rays, axis=1)
    rays /= np.maximum(reach, 1e-9)[:, None]
    faced = np.einsum("ni,ni->n", rays, normals) > np.cos(MAX_INCIDENCE)
    hits = outside.caster.cast(outside.qpos, starts, rays).distances
    result: FloatArray = (out.sum(axis=1) + (faced & (hits >= reach))) / (count + 1)
    return result


def _spread_directions(normals: FloatArray, count: int) -> FloatArray:
    """Return ``count`` unit vectors evenly spread about each of ``normals`` (n, 3), (n, count, 3).

    A Fibonacci lattice on the cap of ``MAX_INCIDENCE``, turned from sample to sample.
    """
    k = np.arange(count) + 0.5
    cosine = 1 - k / count * (1 - np.cos(MAX_INCIDENCE))
    sine = np.sqrt(1 - cosine**2)
    golden = np.pi * (1 + np.sqrt(5))
    angle = golden * k + golden * count * np.arange(len(normals))[:, None]
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    u = np.cross(normals, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    across = np.cos(angle)[..., None] * u[:, None] + np.sin(angle)[..., None] * v[:, None]
    return np.ascontiguousarray(cosine[:, None] * normals[:, None] + sine[:, None] * across)


def _exit_distances(
    origins: FloatArray, directions: FloatArray, box: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return the distances (n,) [m] at which rays from inside the ``box`` leave it."""
    safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    wall = np.where(safe > 0, box[1], box[0])
    distances: FloatArray = ((wall - origins) / safe).min(axis=1)
    return distances


def _sum_outwards(
    triangles: FloatArray, patches: IntArray, middle: FloatArray, count: int
) -> FloatArray:
    """Return whether patches face away from ``middle`` (> 0), weighted by area (count,)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    facing = np.einsum("ni,ni->n", np.cross(b - a, c - a), (a + b + c) / 3 - middle)
    sums: FloatArray = np.bincount(patches, facing, count).astype(np.float64)
    return sums
