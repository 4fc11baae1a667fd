"""Evenly spaced, deterministic samples of a geom's exact surface."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.sim.scenes.facing import Facing
from scan3d_twin.sim.scenes.tessellation import mesh_triangles, mesh_triangles_by_number

Samples = tuple[FloatArray, FloatArray]
"""Points (n, 3) [m] and outward unit normals (n, 3)."""

SAMPLED_TYPES = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_MESH,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
)
"""Geom types that ``sample_geom`` supports."""


def sample_geom(model: Any, geom: int, spacing: float, facing: Facing | None = None) -> Samples:
    """Return samples of a geom's surface, about ``spacing`` [m] apart, in the geom's frame.

    Args:
        model: The compiled scene.
        geom: Id of the geom.
        spacing: Distance of neighbouring samples [m].
        facing: Which sides of a mesh's faces count; None for the sides of their winding.
    """
    size = np.array(model.geom_size[geom])
    match mujoco.mjtGeom(int(model.geom_type[geom])):
        case mujoco.mjtGeom.mjGEOM_BOX:
            return _sample_box(size, spacing)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return _sample_cylinder(size[0], size[1], spacing)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return _sample_sphere(size[0], spacing)
        case mujoco.mjtGeom.mjGEOM_MESH:
            triangles = mesh_triangles_by_number(model, geom)
            return sample_triangles(facing.apply(triangles) if facing else triangles, spacing)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return sample_triangles(_capsule_triangles(size[0], size[1]), spacing)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return sample_triangles(_unit_sphere_triangles() * size, spacing)
        case other:
            raise ValueError(f"no surface samples of a {other.name}")


def sample_triangles(triangles: FloatArray, spacing: float) -> Samples:
    """Return samples of ``triangles`` (m, 3, 3), area-weighted by systematic sampling."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    total = float(double_area.sum()) / 2
    points, chosen = sample_places(triangles, max(1, math.ceil(total / spacing**2)))
    return points, cross[chosen] / double_area[chosen, None]


def sample_places(triangles: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """Return ``count`` points (n, 3) spread over ``triangles`` (m, 3, 3), and their triangles."""
    # Choose the triangles by area
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    places = (np.arange(count) + 0.5) * (double_area.sum() / count)
    chosen = np.searchsorted(np.cumsum(double_area), places).clip(max=len(triangles) - 1)

    # The R2 sequence fills a triangle evenly (M. Roberts, 2018: unreasonable effectiveness of
    # quasirandom sequences); points beyond the diagonal are reflected.
    uv = (np.arange(1, count + 1)[:, None] * (0.7548776662466927, 0.5698402909980532)) % 1.0
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    a, b, c = np.moveaxis(triangles[chosen], 1, 0)
    points: FloatArray = a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a)
    return points, chosen


def _cell_centres(half: float, spacing: float) -> FloatArray:
    """Return the centres of cells about ``spacing`` wide that cover -half..half."""
    n = max(1, round(2 * half / spacing))
    return half * ((2 * np.arange(n) + 1) / n - 1)


def _sample_box(size: FloatArray, spacing: float) -> Samples:
    points, normals = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid = np.meshgrid(
            _cell_centres(size[u], spacing), _cell_centres(size[v], spacing), indexing="ij"
        )
        for sign in (-1.0, 1.0):
            face = np.zeros((grid[0].size, 3))
            face[:, axis], face[:, u], face[:, v] = sign * size[axis], *(g.ravel() for g in grid)
            points.append(face)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(face), 1)))
    return np.concatenate(points), np.concatenate(normals)


def _circle_points(radius: float, spacing: float) -> FloatArray:
    """Return unit vectors (n, 2) to points about ``spacing`` apart on a circle."""
    n = max(3, round(math.tau * radius / spacing))
    angles = math.tau * (np.arange(n) + 0.5) / n
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _sample_cylinder(radius: float, half: float, spacing: float) -> Samples:
    points, normals = [], []
    ring = _circle_points(radius, spacing)
    for z in _cell_centres(half, spacing):
        points.append(np.column_stack([radius * ring, np.full(len(ring), z)]))
        normals.append(np.column_stack([ring, np.zeros(len(ring))]))
    n_rings = max(1, round(radius / spacing))
    for r in radius * (np.arange(n_rings) + 0.5) / n_rings:
        ring = _circle_points(r, spacing)
        for sign in (-1.0, 1.0):
            points.append(np.column_stack([r * ring, np.full(len(ring), sign * half)]))
            normals.append(np.tile([0.0, 0.0, sign], (len(ring), 1)))
    return np.concatenate(points), np.concatenate(normals)


def _sample_sphere(radius: float, spacing: float) -> Samples:
    """Return samples of a sphere on a Fibonacci lattice."""
    n = max(4, round(4 * math.pi * radius**2 / spacing**2))
    k = np.arange(n) + 0.5
    z, angle = 1 - 2 * k / n, math.pi * (1 + math.sqrt(5)) * k
    rho = np.sqrt(1 - z**2)
    normals = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
    return radius * normals, normals


def _capsule_triangles(radius: float, half: float) -> FloatArray:
    """Return triangles (m, 3, 3) of a capsule along z."""
    import trimesh  # slow to import, and rarely needed

    mesh = trimesh.creation.capsule(2 * half, radius, count=[64, 64])
    triangles: FloatArray = np.array(mesh.triangles - mesh.bounds.mean(axis=0))
    return triangles


def _unit_sphere_triangles() -> FloatArray:
    """Return triangles (m, 3, 3) of a sphere of radius 1."""
    import trimesh  # slow to import, and rarely needed

    return np.array(trimesh.creation.icosphere(4).triangles)


def bounding_points(model: Any, geom: int) -> FloatArray:
    """Return points (n, 3) [m] in the geom's frame whose bounding box is the geom's."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        return mesh_triangles(model, geom).reshape(-1, 3)  # its own box is turned to the inertia
    centre, half = np.split(np.array(model.geom_aabb[geom]), 2)
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    result: FloatArray = centre + signs * half
    return result
