"""What the target still hides: faces behind its edges that no view has shown.

The contour spans every niche and gap (``viewpoints``), so that a finished contour may hide surface
in them. Where a view saw the target end in a slice (``profiles``), a face is expected to go back
from there at a right angle to the surface that ends, as the forecast of registrations has it too.
What is left of such faces where surface was seen, where beams passed, or where a viewpoint that was
taken should have shown it, is hidden.

Noise must not decide on it, so that two runs under like conditions take like views: a slice counts
by the median of its readings, and each edge once, however many views saw it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import ndimage

from scan3d_twin.core.planning.profiles import Edge, Profile
from scan3d_twin.core.planning.voxels import passed
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2

CELL = 0.015
"""Side of a cell of a slice [m]: what two lines are apart in an oblique surface at 1 m."""
HEIGHTS = (0.15, 0.30, 0.45)
"""Of the slices [m]: below, at and above the lidar, as in ``frontier2d``; an assumption."""
THICKNESS = 0.15
"""Of a slice [m]: how far one is from the next."""
DEPTH = 0.45
"""A face is expected to go back so far [m]: a quarter of what a sweep sees at the standoff."""
SEEN = 0.03
"""Surface or a beam this near settles what is there [m]: a few sigma of the noise."""
APART, SKEW = 0.10, math.radians(45.0)
"""Edges of two views that are this near, and whose surfaces end in the same direction, are one [m],
[rad]: what registration and a few lines put between them, and less than the least jump."""
FLATTEST = math.radians(75.0)
"""A face seen flatter shows too little of itself; as ``target.GRAZING``."""


@dataclass(frozen=True)
class Faces:
    """Pieces of expected surface in ``world``, ``CELL`` wide and ``THICKNESS`` high.

    Attributes:
        points: (n, 2) [m].
        normals: Outward unit normals (n, 2).
        slices: Index into ``HEIGHTS`` (n,).
    """

    points: FloatArray
    normals: FloatArray
    slices: IntArray

    def __len__(self) -> int:
        return len(self.points)

    @staticmethod
    def joined(parts: Sequence[Faces]) -> Faces:
        """Return all pieces of ``parts`` as one."""
        if not parts:
            return Faces(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
        columns = [[getattr(part, each.name) for part in parts] for each in fields(Faces)]
        return Faces(*(np.concatenate(column) for column in columns))

    def passed_in(self, view: View) -> BoolArray:
        """Tell through which pieces (n,) a beam of ``view`` went, by ``SEEN`` across the face.

        A flat beam tells nothing: it misses a face for long that lies a little farther back.
        """
        points = np.column_stack([self.points, np.array(HEIGHTS)[self.slices]])
        local = view.T_world_scan.inverse().apply(points)
        cosines = np.abs(self.cosines(view.T_world_scan))
        steep = cosines >= math.cos(FLATTEST)
        return steep & passed(local, view.observation.image, SEEN / np.maximum(cosines, 1e-3))

    def cosines(self, pose: Pose2) -> FloatArray:
        """Return the cosines of the incidence at which ``pose`` sees them (n,); negative behind."""
        ways = np.array([pose.x, pose.y]) - self.points
        distance = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        return np.asarray(np.sum(ways * self.normals, axis=1) / distance)

    def select(self, mask: BoolArray) -> Faces:
        """Return the pieces where ``mask`` (n,) is True."""
        return Faces(self.points[mask], self.normals[mask], self.slices[mask])


@dataclass(frozen=True)
class Slices:
    """Cells in which surface of the target was seen, in ``world``.

    Attributes:
        origin: Corner of cell (0, 0) (2,) [m].
        surface: Small holes closed (n_slices, nx, ny).
    """

    origin: FloatArray
    surface: BoolArray

    @staticmethod
    def of(session: Session, profiles: Sequence[Sequence[Profile]]) -> Slices:
        """Return the slices through the target of ``session``: the ``profiles`` of each view."""
        points = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
        low, high = points[:, :2].min(axis=0) - DEPTH, points[:, :2].max(axis=0) + DEPTH
        surface = np.zeros((len(HEIGHTS), *np.ceil((high - low) / CELL).astype(int)), dtype=bool)
        for view, of_view in zip(session.views, profiles, strict=True):
            for index, each in enumerate(of_view):
                places = view.T_world_scan.apply(each.places[each.on_target])
                cells = np.floor((places - low) / CELL).astype(np.int64)
                surface[index, cells[:, 0], cells[:, 1]] = True
        surface = ndimage.binary_closing(surface, np.ones((1, 3, 3), dtype=bool))
        return Slices(low, surface)

    @cached_property
    def distance(self) -> FloatArray:
        """Distance of each cell from surface in its slice (n_slices, nx, ny) [m]."""
        sampling = (1e3, CELL, CELL)
        return np.asarray(ndimage.distance_transform_edt(~self.surface, sampling=sampling))

    def at(
        self, values: BoolArray | FloatArray, points: FloatArray, slices: IntArray
    ) -> FloatArray:
        """Return the ``values`` (n_slices, nx, ny) at ``points`` (..., 2)."""
        cells = np.floor((points - self.origin) / CELL).astype(np.int64)
        cells = np.clip(cells, 0, np.array(self.surface.shape[1:]) - 1)
        return np.asarray(values[slices, cells[..., 0], cells[..., 1]], dtype=np.float64)

    def hides(self, faces: Faces, place: FloatArray) -> BoolArray:
        """Tell of which ``faces`` (n,) surface hides the sight from ``place`` (2,).

        From a cell before them, so that they do not hide themselves.
        """
        starts = faces.points + CELL * faces.normals
        ways = place - starts
        lengths = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        steps = np.arange(CELL, float(np.max(lengths, initial=0.0)), CELL)
        points = starts[:, None] + steps[:, None] * (ways / lengths[:, None])[:, None]
        inside = np.all((points >= self.origin) & (points < self._end), axis=-1)
        met = self.at(self.surface, points, faces.slices[:, None]) > 0
        met &= inside & (steps < lengths[:, None])
        return np.asarray(met.any(axis=1))

    @property
    def _end(self) -> FloatArray:
        return self.origin + CELL * np.array(self.surface.shape[1:])


@dataclass(frozen=True)
class Hidden:
    """The faces of the target of ``session`` that it still hides."""

    session: Session

    @cached_property
    def slices(self) -> Slices:
        """The slices through the target as far as it was seen."""
        return Slices.of(self.session, self._profiles)

    @cached_property
    def _profiles(self) -> list[list[Profile]]:
        """Of each view, one for each slice."""
        return [Profile.through(view, HEIGHTS, THICKNESS) for view in self.session.views]

    @cached_property
    def faces(self) -> Faces:
        """Those that no view so far has settled."""
        views, slices = self.session.views, self.slices
        indices = range(len(HEIGHTS))
        faces = Faces.joined([each for k in indices for each in behind(self._edges(k), k)])
        faces = faces.select(slices.at(slices.distance, faces.points, faces.slices) > SEEN)
        for view in views:
            faces = faces.select(~faces.passed_in(view))
        for view in views:
            faces = faces.select(~self._shown(faces, view.T_world_scan))
        return faces

    def _edges(self, index: int) -> list[Edge]:
        """Return the edges of the target in slice ``index``, in ``world``."""
        edges = []
        for view, profiles in zip(self.session.views, self._profiles, strict=True):
            edges += [each.seen_from(view.T_world_scan) for each in profiles[index].edges()]
        return distinct(edges)

    def areas(self, poses: Iterable[Pose2]) -> FloatArray:
        """Return how much of the hidden faces each of ``poses`` in ``world`` shows (n,) [m2].

        As it is seen, foreshortened: so many readings there are, and what shows at a flat angle
        only, which a centimetre here or there decides on, counts for little.
        """
        shown = [(self.faces.select(self._shown(self.faces, pose)), pose) for pose in poses]
        return CELL * THICKNESS * np.array([faces.cosines(pose).sum() for faces, pose in shown])

    def _shown(self, faces: Faces, pose: Pose2) -> BoolArray:
        """Tell which ``faces`` (n,) a sweep at ``pose`` shows."""
        config = self.session.config
        ways = np.array([pose.x, pose.y]) - faces.points
        distance = np.linalg.norm(ways, axis=1)
        local = pose.inverse().apply(faces.points)
        shown = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= config.sweep.width / 2
        shown &= faces.cosines(pose) >= math.cos(FLATTEST)
        shown &= distance <= 2 * config.planning.standoff
        hidden = self.slices.hides(faces.select(shown), np.array([pose.x, pose.y]))
        shown[shown] = ~hidden
        return np.asarray(shown)


def behind(edges: Iterable[Edge], index: int) -> Iterator[Faces]:
    """Yield the face behind each of the ``edges`` in ``world`` of slice ``index``.

    It goes back at a right angle to the surface that ends there.
    """
    depth = np.arange(CELL, DEPTH, CELL)[:, None]
    for edge in edges:
        points = edge.place - depth * edge.normal
        normals = np.tile(edge.onwards, (len(points), 1))
        yield Faces(points, normals, np.full(len(points), index))


def distinct(edges: Iterable[Edge]) -> list[Edge]:
    """Return each edge once, where it was seen best."""
    kept: list[Edge] = []
    for edge in sorted(edges, key=lambda each: each.spacing):
        if not any(_same(edge, other) for other in kept):
            kept.append(edge)
    return kept


def _same(a: Edge, b: Edge) -> bool:
    apart = float(np.linalg.norm(a.place - b.place))
    return apart <= APART and float(a.onwards @ b.onwards) >= math.cos(SKEW)
