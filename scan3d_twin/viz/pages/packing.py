"""What a page shows in 3D, packed for WebGL."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.model.evaluation import Comparison
from scan3d_twin.core.model.fused_cloud import Model, number_voxels
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.viz.cloud import Camera, shade_normals, surrounding_points
from scan3d_twin.viz.pages.point_values import PointValues, measure_points

MAX_TARGET_POINTS = 250_000
"""Most points of the target in a page: 12 bytes each, 4 MB as text."""
MAX_VALUES = 5
"""Most figures of a point that a page can colour by."""
POINT_RECORD = np.dtype(
    [("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("shade", "u1"), ("values", "u1", (MAX_VALUES,))]
)
"""A point or a corner: place between ``low`` and ``low + extent``, brightness, and its figures."""
MAX_MISSING_POINTS = 40_000
MESH_VOXEL = 0.01
"""Side of the voxels in which the corners of the mesh become one [m]: twice the noise."""
MAX_TRIANGLES = 100_000
"""Most triangles of a mesh in a page: 12 bytes each; the voxels grow until they are fewer."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A viewpoint to draw.

    Attributes:
        group: Index of the group whose colour it has.
        pose: ``T_world_scan``.
        width: Horizontal angle of its sweep [rad].
    """

    group: int
    pose: Pose2
    width: float


@dataclass(frozen=True, slots=True)
class Shown:
    """What a page shows in 3D.

    Attributes:
        title: What the groups are, such as ``Views``.
        groups: Names of the groups of points, such as the number of each view.
        marks: The viewpoints.
        model: The points of the target; ``view`` is the group.
        values: What they can be coloured by, each (n,).
        around: Points of the surroundings (m, 3) [m].
        missing: Points of the surface that could be covered and are not (k, 3) [m].
        mesh: The target's surface.
    """

    title: str
    groups: tuple[str, ...]
    marks: tuple[Mark, ...]
    model: Model
    values: tuple[PointValues, ...]
    around: FloatArray
    missing: FloatArray
    mesh: Mesh


def show_run(session: Session, model: Model, mesh: Mesh, compared: Comparison | None) -> Shown:
    """Return what the page of ``session`` shows; what is missing only where it was ``compared``."""
    missing = np.zeros((0, 3)) if compared is None else compared.missing
    values = measure_points(model, session, compared)
    groups = tuple(f"{k}" for k in range(len(session.views)))
    width = session.config.sweep.width
    marks = tuple(Mark(k, view.T_world_scan, width) for k, view in enumerate(session.views))
    around = surrounding_points(session)
    return Shown("Views", groups, marks, model, values, around, missing, mesh)


@dataclass(frozen=True, slots=True)
class PackedCloud:
    """Points and corners as records of 12 bytes, see ``POINT_RECORD``.

    Attributes:
        data: The records: group by group, surroundings, missing surface, corners of the mesh.
        ranges: First record and number of records of each of these.
        faces: Indices of the mesh's corners, three a triangle, as 32 bits; 0 is its first.
        low: Origin of the coordinates (3,) [m].
        extent: Length of 65535 units [m].
    """

    data: bytes
    ranges: list[tuple[int, int]]
    faces: bytes
    low: FloatArray
    extent: float


def pack(shown: Shown, camera: Camera) -> PackedCloud:
    """Return all that is ``shown`` packed for a page, thinned, and lit for ``camera``."""
    # Sort by group and thin
    model = shown.model
    order = np.argsort(model.view, kind="stable")
    order = order[:: max(1, math.ceil(len(model) / MAX_TARGET_POINTS))]
    chosen = model.select(order)
    missing = shown.missing[:: max(1, math.ceil(len(shown.missing) / MAX_MISSING_POINTS))]
    mesh = simplify(shown.mesh, MESH_VOXEL)
    points = np.concatenate([chosen.points, shown.around, missing, mesh.vertices])

    # Quantise coordinates to 16 bits
    low = points.min(axis=0) if len(points) else np.zeros(3)
    extent = max(1e-3, float(np.ptp(points, axis=0).max())) if len(points) else 1.0
    records = np.zeros(len(points), POINT_RECORD)
    for axis, name in enumerate("xyz"):
        records[name] = np.round((points[:, axis] - low[axis]) / extent * 65535)

    # Light the surfaces, add the figures
    flat = np.full(len(shown.around) + len(missing), 0.8)
    corners = shade_normals(_corner_normals(mesh), camera)
    light = np.concatenate([shade_normals(chosen.normals, camera), flat, corners])
    records["shade"] = np.round(255 * light)
    for k, each in enumerate(shown.values):
        records["values"][: len(chosen), k] = each.to_bytes()[order]

    # Find the ranges
    seen = np.bincount(chosen.view, minlength=len(shown.groups))
    counts = [*seen, len(shown.around), len(missing), len(mesh.vertices)]
    firsts = np.cumsum([0, *counts[:-1]])
    ranges = [(int(first), int(count)) for first, count in zip(firsts, counts, strict=True)]
    faces = mesh.faces.astype("<u4").tobytes()
    return PackedCloud(records.tobytes(), ranges, faces, low, extent)


def simplify(mesh: Mesh, voxel: float) -> Mesh:
    """Return ``mesh`` with the corners in each voxel of side ``voxel`` [m] or more made one.

    Triangles that become lines, and copies of others, are dropped (vertex clustering: Rossignac and
    Borrel 1993).
    """
    if len(mesh.faces) == 0:
        return mesh
    number = number_voxels(mesh.vertices, voxel)
    count = np.bincount(number)
    corners = np.stack([np.bincount(number, mesh.vertices[:, i]) / count for i in range(3)], axis=1)
    faces = number[mesh.faces]
    faces = faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(first) > MAX_TRIANGLES:
        return simplify(mesh, 1.5 * voxel)
    return Mesh(corners, faces[np.sort(first)], np.full(len(corners), -1))


def _corner_normals(mesh: Mesh) -> FloatArray:
    """Return the unit normal at each corner (n, 3), the mean of its triangles by area."""
    normals = np.zeros((len(mesh.vertices), 3))
    if len(mesh.faces):
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        for i in range(3):
            np.add.at(normals, mesh.faces[:, i], np.cross(b - a, c - a))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, np.nan))
