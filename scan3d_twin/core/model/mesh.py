"""The mesh: triangles between the neighbouring readings of each view, merged; holes stay holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.model.fused_cloud import Model, ViewCloud
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray

MAX_EDGE_SPACINGS = 4.0
"""Largest length of an edge of a triangle, in spacings of the readings; longer ones are depth
edges. It admits 75 deg of incidence; Turk and Levoy, SIGGRAPH 1994, use 4, too."""
MAX_EDGE_SIGMAS = 4.0
"""Allowance for noise in the length of an edge, in standard deviations of two readings."""
SAME_SURFACE_DISTANCE = 0.02
"""Distance within which surfaces of two views are the same [m]; twice the wanted accuracy."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Vertices in ``world`` (n, 3) [m].
        faces: Indices of the corners (m, 3), counter-clockwise as seen by the lidar.
        view: Index of each vertex's view (n,); -1 for a vertex of all views.
    """

    vertices: FloatArray
    faces: IntArray
    view: IntArray

    @property
    def areas(self) -> FloatArray:
        """Area of each triangle (m,) [m2]."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return ``n`` random points (n, 3), uniform over the surface; none without a surface."""
        areas = self.areas
        if areas.sum() <= 0:
            return np.zeros((0, 3))
        face = rng.choice(len(areas), n, p=areas / areas.sum())
        u, v = rng.random((2, n, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        a, b, c = (self.vertices[self.faces[face, i]] for i in range(3))
        return np.asarray(a + u * (b - a) + v * (c - a))


def build_mesh(session: Session, seen: Sequence[ViewCloud]) -> Mesh:
    """Return the target's surface: the triangles of all views, the best where views overlap.

    Readings that are missing or were filled in, and depth edges, leave holes. Where two views
    overlap, the one with the smaller standard deviation is kept; seams are not closed.

    Args:
        session: The views.
        seen: The target points of each view, by ``build_view_clouds``.
    """
    models = [each.model for each in seen]
    trees = [Tree.of(model.points) for model in models]
    kept = [
        _keep_best_seen(k, triangulate(view, each), models, trees)
        for k, (view, each) in enumerate(zip(session.views, seen, strict=True))
    ]
    return _drop_unused_vertices(_join_meshes(kept))


def triangulate(view: View, seen: ViewCloud) -> Mesh:
    """Return a view's target as triangles between neighbouring beams of neighbouring lines.

    Args:
        view: The view.
        seen: Its target points; the vertices are the smoothed ones.
    """
    # Number the measured readings
    target, vertices = view.target, seen.smoothed
    grid = np.full(view.image.ranges.shape, -1, dtype=np.int64)
    measured = view.image.codes[target.lines, target.beams] == VALID
    grid[target.lines[measured], target.beams[measured]] = np.flatnonzero(measured)

    # Cut each cell into triangles
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    # Lines run left to right and beams upwards: this way round the triangles face the lidar.
    corners = np.concatenate(
        [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, d, c), (a, c, b))]
    )

    # Drop gaps and depth edges
    faces = corners[(corners >= 0).all(axis=1)]
    faces = faces[_is_surface(faces, vertices, view, seen.model)]
    return Mesh(vertices, faces, seen.model.view)


def _is_surface(faces: IntArray, vertices: FloatArray, view: View, model: Model) -> BoolArray:
    """Return which ``faces`` (m, 3) have no depth edge among their edges (m,)."""
    if len(faces) == 0:
        return np.zeros(0, dtype=bool)

    # Limit the length by spacing and noise
    image, target = view.image, view.target
    between_beams = float(np.median(np.diff(image.spec.elevations)))
    between_lines = float(np.median(-np.diff(image.yaws[:, image.spec.n_beams // 2])))
    r = image.ranges[target.lines, target.beams]
    spacing = r * np.hypot(between_beams, between_lines)
    limit = MAX_EDGE_SPACINGS * spacing + MAX_EDGE_SIGMAS * np.sqrt(2.0) * float(
        np.median(model.sigma)
    )

    # Check the three edges
    whole, columns = np.ones(len(faces), dtype=bool), np.ascontiguousarray(vertices.T)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        length = _measure_edges(columns, faces[:, i], faces[:, j])
        whole &= length <= np.minimum(limit[faces[:, i]], limit[faces[:, j]])
    return whole


def _measure_edges(columns: FloatArray, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the lengths (m,) of edges between vertices, given by their ``columns`` (3, n).

    Column by column: a view has a hundred thousand faces, and most memory of a tour is held here.
    """
    square = np.zeros(len(starts))
    for column in columns:
        step = column[starts] - column[ends]
        step *= step
        square += step
    return np.sqrt(square)


def _keep_best_seen(k: int, mesh: Mesh, models: Sequence[Model], trees: Sequence[Tree]) -> Mesh:
    """Return ``mesh`` of view ``k`` without the triangles that another view saw better.

    Args:
        k: Index of the view.
        mesh: Its triangles.
        models: The target points of all views.
        trees: Search trees over the points of ``models``.
    """
    if len(mesh.faces) == 0:
        return mesh

    # Compare with the other views
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    own = models[k].sigma[mesh.faces].mean(axis=1)
    keep = np.ones(len(mesh.faces), dtype=bool)
    for other, (model, tree) in enumerate(zip(models, trees, strict=True)):
        if other == k or len(model) == 0:
            continue
        _, index = tree.closest(centres, SAME_SURFACE_DISTANCE)
        near = index < len(model)
        theirs = model.sigma[np.minimum(index, len(model) - 1)]
        keep &= ~(near & ((theirs < own) | ((theirs == own) & (other < k))))
    return Mesh(mesh.vertices, mesh.faces[keep], mesh.view)


def _join_meshes(meshes: list[Mesh]) -> Mesh:
    """Return all ``meshes`` as one mesh."""
    if not meshes:
        none = np.zeros(0, dtype=np.int64)
        return Mesh(np.zeros((0, 3)), none.reshape(0, 3), none)
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]),
        np.concatenate([mesh.view for mesh in meshes]),
    )


def _drop_unused_vertices(mesh: Mesh) -> Mesh:
    """Return ``mesh`` without vertices that no triangle uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3), mesh.view[used])
