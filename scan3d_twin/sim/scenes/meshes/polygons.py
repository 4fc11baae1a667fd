"""Polygons of mesh files as triangles; concave ones by cutting ears, not by a fan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

Polygon = Sequence[int] | IntArray


def triangulate(
    vertices: FloatArray, polygons: Sequence[Polygon] | IntArray, label: str
) -> IntArray:
    """Return the triangles (m, 3) of ``polygons`` of indices into ``vertices`` (n, 3).

    Polygons of fewer than three corners have none.

    Args:
        vertices: (n, 3).
        polygons: Indices of the corners, in order; an array where all have as many.
        label: The file in messages.

    Raises:
        SceneError: An index is out of range.
    """
    if isinstance(polygons, np.ndarray) and polygons.shape[1] == 3:
        check_indices(polygons.ravel(), len(vertices), label)
        return polygons
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    try:
        corners = np.array([index for polygon in polygons for index in polygon], dtype=np.int64)
    except OverflowError:
        raise SceneError(f"{label} is damaged: the number of a vertex has over 64 bits") from None
    check_indices(corners, len(vertices), label)
    starts = np.cumsum(sizes) - sizes
    parts = [corners[starts[sizes == 3][:, None] + np.arange(3)]]

    # Fans of convex polygons, ears of the others
    for size in np.unique(sizes[sizes > 3]).tolist():
        rings = corners[starts[sizes == size][:, None] + np.arange(size)]
        convex = _are_convex(vertices[rings])
        fan = [rings[convex][:, [0, k, k + 1]] for k in range(1, size - 1)]
        parts += [np.stack(fan, axis=1).reshape(-1, 3)]
        parts += [_cut_ears(vertices, ring) for ring in rings[~convex]]
    result: IntArray = np.concatenate(parts)
    return result


def check_indices(indices: IntArray, count: int, label: str) -> None:
    """Refuse ``indices`` that are not of ``count`` vertices.

    Raises:
        SceneError: An index is out of range.
    """
    if len(indices) and not (indices.min() >= 0 and indices.max() < count):
        wrong = int(indices.max() if indices.max() >= count else indices.min())
        raise SceneError(
            f"{label} is damaged: a face refers to vertex {wrong} (from 0 on) of {count}; export "
            "it again"
        )


def _normals(rings: FloatArray) -> FloatArray:
    """Return the vector areas (k, 3) of ``rings`` (k, size, 3): Newell's method, doubled."""
    centred = rings - rings[:, :1]
    return np.asarray(np.cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1))


def _turns(rings: FloatArray) -> FloatArray:
    """Return how far the corners of ``rings`` (k, size, 3) turn to the left (k, size)."""
    before, after = rings - np.roll(rings, 1, axis=1), np.roll(rings, -1, axis=1) - rings
    return np.asarray(np.einsum("ksi,ki->ks", np.cross(before, after), _normals(rings)))


def _are_convex(rings: FloatArray) -> BoolArray:
    """Return which ``rings`` (k, size, 3) turn one way at all corners (k,)."""
    turns = _turns(rings)
    limit = 1e-9 * np.abs(turns).max(axis=1, keepdims=True)
    return np.asarray((turns >= -limit).all(axis=1))


def _cut_ears(vertices: FloatArray, ring: IntArray) -> IntArray:
    """Return the triangles (k, 3) of a simple polygon, wound as it is.

    Corners on a straight line may be left out (Mapbox's ear clipping).
    """
    import mapbox_earcut  # only few meshes need it

    # Project it along its normal
    normal = _normals(vertices[ring][None])[0]
    axis = int(np.argmax(np.abs(normal)))
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    flat = np.ascontiguousarray(vertices[ring][:, kept] * (1.0, np.sign(normal[axis]) or 1.0))

    # Cut it, and turn the triangles as the polygon
    end = np.array([len(ring)], np.uint32)
    corners = mapbox_earcut.triangulate_float64(flat, end).reshape(-1, 3).astype(np.int64)
    a, b, c = (flat[corners[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    turned = (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() < 0
    result: IntArray = ring[corners[:, ::-1] if turned else corners]
    return result
