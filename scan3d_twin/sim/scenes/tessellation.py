"""A geom's surface as triangles, outward facing, in the geom's frame."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray

CHORD_TOLERANCE = 1e-4
"""Largest distance of a chord from the surface [m]."""
PLANE_REACH = 100.0
"""Half the side of the square that replaces an infinite plane [m]; the lidar sees 4 m."""

_GEOM = mujoco.mjtGeom
TRIANGULATED_TYPES = (
    _GEOM.mjGEOM_PLANE,
    _GEOM.mjGEOM_HFIELD,
    _GEOM.mjGEOM_BOX,
    _GEOM.mjGEOM_SPHERE,
    _GEOM.mjGEOM_ELLIPSOID,
    _GEOM.mjGEOM_CYLINDER,
    _GEOM.mjGEOM_CAPSULE,
    _GEOM.mjGEOM_MESH,
)
"""Geom types that ``geom_triangles`` supports."""


def geom_triangles(model: Any, geom: int) -> FloatArray:
    """Return the triangles (m, 3, 3) [m] of a geom."""
    size = np.array(model.geom_size[geom])
    match mujoco.mjtGeom(int(model.geom_type[geom])):
        case mujoco.mjtGeom.mjGEOM_PLANE:
            return _plane_triangles(size)
        case mujoco.mjtGeom.mjGEOM_HFIELD:
            return _height_field_triangles(model, geom)
        case mujoco.mjtGeom.mjGEOM_BOX:
            return _box_triangles(size)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return _revolve(_arc_points(size[0], -90, 90), size[0])
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            largest, widest = float(size.max()), float(size[:2].max())
            profile = _arc_points(largest, -90, 90) / largest
            stretched: FloatArray = _revolve(profile, widest) * size
            return stretched
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            r, half = size[:2]
            return _revolve(np.array([[0, -half], [r, -half], [r, half], [0, half]]), r)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            r, half = size[:2]
            end = np.array([0.0, half])
            ends = [_arc_points(r, -90, 0) - end, end + _arc_points(r, 0, 90)]
            return _revolve(np.concatenate(ends), r)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return mesh_triangles(model, geom)
        case other:
            raise ValueError(f"no triangles of a {other.name}")


def mesh_triangles(model: Any, geom: int) -> FloatArray:
    """Return a mesh geom's triangles (m, 3, 3) in the geom's frame."""
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertex = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
    faces = model.mesh_face[first : first + count]
    triangles: FloatArray = np.asarray(vertices, dtype=np.float64)[faces]
    return triangles


def mesh_triangles_by_number(model: Any, geom: int) -> FloatArray:
    """Return ``mesh_triangles``, each from its corner of the least number.

    Files list a face that is turned over from any of its corners.
    """
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    least = model.mesh_face[first : first + count].argmin(axis=1)
    corners = (least[:, None] + np.arange(3)) % 3
    triangles: FloatArray = np.take_along_axis(
        mesh_triangles(model, geom), corners[:, :, None], axis=1
    )
    return triangles


def _segment_count(radius: float, angle: float) -> int:
    """Return the number of chords for an arc of ``angle`` [rad] within ``CHORD_TOLERANCE``."""
    # A chord over the angle a lies radius * a^2 / 8 below the arc.
    return min(512, max(6, math.ceil(angle / math.sqrt(8 * CHORD_TOLERANCE / radius))))


def _arc_points(radius: float, first: float, last: float) -> FloatArray:
    """Return points (n, 2), radius and height, from latitude ``first`` to ``last`` [deg]."""
    n = _segment_count(radius, math.radians(last - first))
    latitudes = np.radians(np.linspace(first, last, n + 1))
    points: FloatArray = radius * np.stack([np.cos(latitudes), np.sin(latitudes)], axis=1)
    points[np.abs(points[:, 0]) < 1e-12, 0] = 0.0
    return points


def _revolve(profile: FloatArray, radius: float) -> FloatArray:
    """Return the surface of revolution about z of an upward ``profile`` (n, 2): radius, height."""
    # Place rings of vertices
    n = _segment_count(radius, math.tau)
    angles = math.tau * np.arange(n) / n
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rows = [np.column_stack([r * ring, np.full(n, z)]) for r, z in profile]

    # Join neighbouring rings
    triangles = []
    for (r_low, _), (r_high, _), low, high in zip(
        profile[:-1], profile[1:], rows[:-1], rows[1:], strict=True
    ):
        next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        if r_low > 0:
            triangles.append(np.stack([low, next_low, next_high], axis=1))
        if r_high > 0:
            triangles.append(np.stack([low, next_high, high], axis=1))
    return np.concatenate(triangles)


def _plane_triangles(size: FloatArray) -> FloatArray:
    x, y = (half if half > 0 else PLANE_REACH for half in size[:2])
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def _height_field_triangles(model: Any, geom: int) -> FloatArray:
    """Return the triangles of a height field, split as MuJoCo does, its sides and its bottom."""
    # Place the vertices of the top
    field = model.geom_dataid[geom]
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    first = int(model.hfield_adr[field])
    heights = np.array(model.hfield_data[first : first + rows * columns]).reshape(rows, columns)
    x_half, y_half, z_scale, base = (float(value) for value in model.hfield_size[field])
    x, y = np.meshgrid(np.linspace(-x_half, x_half, columns), np.linspace(-y_half, y_half, rows))
    top = np.stack([x, y, z_scale * heights], axis=-1)

    # Split each cell along its diagonal
    a, b, c, d = top[:-1, :-1], top[:-1, 1:], top[1:, 1:], top[1:, :-1]
    cells = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]

    # Close it by sides down to the base
    rim = np.concatenate([top[0], top[1:, -1], top[-1, -2::-1], top[-2::-1, 0]])
    low = rim * (1.0, 1.0, 0.0) - (0.0, 0.0, base)
    sides = [
        np.stack([low[:-1], low[1:], rim[1:]], axis=1),
        np.stack([low[:-1], rim[1:], rim[:-1]], axis=1),
    ]
    corners = np.array([[-x_half, -y_half], [-x_half, y_half], [x_half, y_half], [x_half, -y_half]])
    bottom = np.column_stack([corners, np.full(4, -base)])[[[0, 1, 2], [0, 2, 3]]]
    return np.concatenate([*cells, *sides, bottom])


def _box_triangles(size: FloatArray) -> FloatArray:
    faces = []
    square = np.array([[[-1, -1], [1, -1], [1, 1]], [[-1, -1], [1, 1], [-1, 1]]], dtype=float)
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((2, 3, 3))
            face[..., axis] = sign
            face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = square[..., 0], square[..., 1]
            faces.append(face if sign > 0 else face[:, ::-1])
    triangles: FloatArray = np.concatenate(faces) * size
    return triangles
