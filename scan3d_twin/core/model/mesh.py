"""The model as triangles: each view's grid of lines and beams, holes left as holes, merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.model.fused_cloud import Model, Sighting
from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray

LONGEST_EDGE = 4.0
"""Edges longer than so many times the spacing of the readings are depth edges, not surface: up to
75 deg of incidence; Turk and Levoy, SIGGRAPH 1994, take 4 too."""
NOISE_EDGE = 4.0
"""Besides, two readings of one surface may differ by so many standard deviations."""
SAME_SURFACE = 0.02
"""Surfaces of two views this near are the same one [m]; twice the wanted accuracy."""


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    Attributes:
        vertices: (n, 3) in ``world`` [m].
        faces: Indices of the corners (m, 3), counter-clockwise as seen by the lidar.
        view: Index of the view each vertex came from (n,); -1 where it came from all.
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
        """Return ``n`` points (n, 3) spread evenly over the surface; none if there is none."""
        areas = self.areas
        if areas.sum() <= 0:
            return np.zeros((0, 3))
        face = rng.choice(len(areas), n, p=areas / areas.sum())
        u, v = rng.random((2, n, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        a, b, c = (self.vertices[self.faces[face, i]] for i in range(3))
        return np.asarray(a + u * (b - a) + v * (c - a))


def build_mesh(session: Session, seen: Sequence[Sighting]) -> Mesh:
    """Return the target's surface: the views' triangles, each place from the view that saw it best.

    Readings that are missing or were filled in, and depth edges, leave holes. Where two views
    overlap the one with the smaller standard deviation is kept; seams are not sewn.

    Args:
        session: The views.
        seen: What each of them shows of the target, as ``sightings`` gives it.
    """
    models = [each.model for each in seen]
    trees = [cKDTree(model.points) for model in models]
    kept = [
        _best_seen(k, triangulate(view, each), models, trees)
        for k, (view, each) in enumerate(zip(session.views, seen, strict=True))
    ]
    return _compact(_joined(kept))


def triangulate(view: View, seen: Sighting) -> Mesh:
    """Return a view's target as triangles between neighbouring beams of neighbouring lines.

    Args:
        view: The view; its readings are smoothed within surfaces.
        seen: What it shows of the target.
    """
    target, vertices = view.target, seen.smoothed
    grid = np.full(view.image.ranges.shape, -1, dtype=np.int64)
    measured = view.image.codes[target.lines, target.beams] == VALID
    grid[target.lines[measured], target.beams[measured]] = np.flatnonzero(measured)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    # Lines run left to right and beams upwards: this way round the triangles face the lidar.
    corners = np.concatenate(
        [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, d, c), (a, c, b))]
    )
    faces = corners[(corners >= 0).all(axis=1)]
    faces = faces[_is_surface(faces, vertices, view, seen.model)]
    return Mesh(vertices, faces, seen.model.view)


def _is_surface(faces: IntArray, vertices: FloatArray, view: View, model: Model) -> BoolArray:
    """Tell which ``faces`` (m, 3) have no edge that leaps from one surface to another (m,)."""
    image, target = view.image, view.target
    between_beams = float(np.median(np.diff(image.spec.elevations)))
    between_lines = float(np.median(-np.diff(image.yaws[:, image.spec.n_beams // 2])))
    r = image.ranges[target.lines, target.beams]
    spacing = r * np.hypot(between_beams, between_lines)
    limit = LONGEST_EDGE * spacing + NOISE_EDGE * np.sqrt(2.0) * float(np.median(model.sigma))
    whole = np.ones(len(faces), dtype=bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        length = np.linalg.norm(vertices[faces[:, i]] - vertices[faces[:, j]], axis=1)
        whole &= length <= np.minimum(limit[faces[:, i]], limit[faces[:, j]])
    return whole


def _best_seen(k: int, mesh: Mesh, models: Sequence[Model], trees: Sequence[cKDTree]) -> Mesh:
    """Return ``mesh`` of view ``k`` without the triangles that another view saw better.

    Args:
        k: The view.
        mesh: Its triangles.
        models: Of all views.
        trees: Of the points of ``models``.
    """
    if len(mesh.faces) == 0:
        return mesh
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    own = models[k].sigma[mesh.faces].mean(axis=1)
    keep = np.ones(len(mesh.faces), dtype=bool)
    for other, (model, tree) in enumerate(zip(models, trees, strict=True)):
        if other == k or len(model) == 0:
            continue
        _, index = nearest(tree, centres, SAME_SURFACE)
        near = index < len(model)
        theirs = model.sigma[np.minimum(index, len(model) - 1)]
        keep &= ~(near & ((theirs < own) | ((theirs == own) & (other < k))))
    return Mesh(mesh.vertices, mesh.faces[keep], mesh.view)


def _joined(meshes: list[Mesh]) -> Mesh:
    """Return all ``meshes`` as one."""
    if not meshes:
        none = np.zeros(0, dtype=np.int64)
        return Mesh(np.zeros((0, 3)), none.reshape(0, 3), none)
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]),
        np.concatenate([mesh.view for mesh in meshes]),
    )


def _compact(mesh: Mesh) -> Mesh:
    """Return ``mesh`` without vertices that no triangle uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3), mesh.view[used])
