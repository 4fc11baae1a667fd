"""Hidden surface: expected faces behind the target's edges that no view has shown yet.

The contour spans niches and gaps (``viewpoints``), so that surface may be hidden in them when the
contour is complete. Where a view saw the target end in a horizontal slice (``profiles``), a face is
expected to go back from there at a right angle to the surface that ends, as in the error
prediction. Parts of such faces are settled where surface was seen, where beams passed, or where a
view should have shown them; the rest is hidden.

Two runs under similar conditions should take similar views, in spite of noise: a slice counts by
the median of its readings, and each edge counts once, even if several views saw it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from scan3d_twin.core.grids import dilate, erode
from scan3d_twin.core.planning.candidates.profiles import Edge, Profile
from scan3d_twin.core.planning.surface.voxels import is_passed
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.session import Session, View, Workspace
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2

SLICE_CELL = 0.015
"""Side of a cell of a slice [m]: the spacing of lines on an oblique surface at 1 m."""
SLICE_HEIGHTS = (0.15, 0.30, 0.45)
"""Heights of the slices [m]: below, at and above the lidar, as in ``frontier2d``; an assumption."""
SLICE_THICKNESS = 0.15
"""Thickness of a slice [m]: the distance from one to the next."""
FACE_DEPTH = 0.45
"""Expected depth of a face behind an edge [m]: a quarter of a sweep's width at the standoff."""
SETTLED_DISTANCE = 0.03
"""Distance of seen surface, or of a beam, within which a face is settled [m]: a few sigma of the
noise."""
SAME_EDGE_DISTANCE, SAME_EDGE_ANGLE = 0.10, math.radians(45.0)
"""Distance [m] and difference of direction [rad] within which edges of two views are the same: the
errors of registration and of a few lines, and less than the smallest jump."""
SQUARE_RADIUS = math.sqrt(2.0)
"""Radius of the disc of 3 x 3 cells, corners included [cells]."""
MAX_INCIDENCE = math.radians(75.0)
"""Incidence above which a face is not shown [rad]; as ``MAX_WALL_INCIDENCE``."""


@dataclass(frozen=True)
class Faces:
    """Pieces of expected surface in ``world``, ``SLICE_CELL`` wide and ``SLICE_THICKNESS`` high.

    Attributes:
        points: Top view (n, 2) [m].
        normals: Outward unit normals (n, 2).
        slices: Index into ``SLICE_HEIGHTS`` (n,).
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

    def are_passed_in(self, view: View) -> BoolArray:
        """Return through which pieces (n,) a beam of ``view`` passed, by ``SETTLED_DISTANCE``.

        Beams at a flat angle do not count: they miss a face that is slightly farther back.
        """
        points = np.column_stack([self.points, np.array(SLICE_HEIGHTS)[self.slices]])
        local = view.T_world_scan.inverse().apply(points)
        cosines = np.abs(self.cosines(view.T_world_scan))
        steep = cosines >= math.cos(MAX_INCIDENCE)
        return steep & is_passed(
            local, view.observation.image, SETTLED_DISTANCE / np.maximum(cosines, 1e-3)
        )

    def cosines(self, pose: Pose2) -> FloatArray:
        """Return the cosine of the incidence from ``pose`` (n,); negative from behind."""
        ways = np.array([pose.x, pose.y]) - self.points
        distance = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        return np.asarray(np.sum(ways * self.normals, axis=1) / distance)

    def select(self, mask: BoolArray) -> Faces:
        """Return the pieces where ``mask`` (n,) is True."""
        return Faces(self.points[mask], self.normals[mask], self.slices[mask])


@dataclass(frozen=True)
class Slices:
    """Horizontal slices through the target, as grids of cells in ``world``.

    Attributes:
        origin: Corner of cell (0, 0) (2,) [m].
        surface: Cells in which surface was seen, with small holes closed (n_slices, nx, ny).
    """

    origin: FloatArray
    surface: BoolArray

    @staticmethod
    def of(session: Session, profiles: Sequence[Sequence[Profile]]) -> Slices:
        """Return the slices through the target of ``session`` by the ``profiles`` of each view."""
        # Cover the target and its depth
        points = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
        low, high = points[:, :2].min(axis=0) - FACE_DEPTH, points[:, :2].max(axis=0) + FACE_DEPTH
        surface = np.zeros(
            (len(SLICE_HEIGHTS), *np.ceil((high - low) / SLICE_CELL).astype(int)), dtype=bool
        )

        # Mark the profiles of all views
        for view, of_view in zip(session.views, profiles, strict=True):
            for index, each in enumerate(of_view):
                places = view.T_world_scan.apply(each.places[each.on_target])
                cells = np.floor((places - low) / SLICE_CELL).astype(np.int64)
                surface[index, cells[:, 0], cells[:, 1]] = True
        return Slices(low, np.stack([_close_holes(grid) for grid in surface]))

    @cached_property
    def settled(self) -> BoolArray:
        """Cells within ``SETTLED_DISTANCE`` of surface in their slice (n_slices, nx, ny)."""
        return np.stack([dilate(grid, SETTLED_DISTANCE, SLICE_CELL) for grid in self.surface])

    def at(
        self, values: BoolArray | FloatArray, points: FloatArray, slices: IntArray
    ) -> FloatArray:
        """Return the ``values`` (n_slices, nx, ny) at ``points`` (..., 2)."""
        cells = np.floor((points - self.origin) / SLICE_CELL).astype(np.int64)
        cells = np.clip(cells, 0, np.array(self.surface.shape[1:]) - 1)
        return np.asarray(values[slices, cells[..., 0], cells[..., 1]], dtype=np.float64)

    def find_hidden(self, faces: Faces, place: FloatArray) -> BoolArray:
        """Return which ``faces`` (n,) are hidden from ``place`` (2,) by surface.

        Rays start one cell in front of the faces, so that they do not hide themselves.
        """
        # Test at steps as far as the farthest ray goes
        points, normals = np.ascontiguousarray(faces.points), np.ascontiguousarray(faces.normals)
        longest = np.linalg.norm(place - (points + SLICE_CELL * normals), axis=1)
        steps = np.arange(SLICE_CELL, float(np.max(longest, initial=0.0)), SLICE_CELL)

        # Look up surface on them
        hidden = np.empty(len(faces), dtype=bool)
        engine.find_hidden(
            np.ascontiguousarray(self.surface), *self.surface.shape[1:], self.origin, self._end,
            SLICE_CELL, points, normals, np.ascontiguousarray(faces.slices), len(faces), place,
            steps, len(steps), hidden,
        )  # fmt: skip
        return hidden

    @property
    def _end(self) -> FloatArray:
        return self.origin + SLICE_CELL * np.array(self.surface.shape[1:])


@dataclass(frozen=True)
class HiddenSurface:
    """The expected faces of the target of ``session`` that are still hidden."""

    session: Session

    @cached_property
    def slices(self) -> Slices:
        """The slices through the target."""
        return Slices.of(self.session, self._profiles)

    @cached_property
    def _profiles(self) -> list[list[Profile]]:
        """The profiles of each view, one for each slice."""
        return [_recall_profiles(view, self.session.workspace) for view in self.session.views]

    @cached_property
    def faces(self) -> Faces:
        """The expected faces that no view has settled."""
        # Expect faces behind all edges
        views, slices = self.session.views, self.slices
        indices = range(len(SLICE_HEIGHTS))
        faces = Faces.joined([each for k in indices for each in expect_faces(self._edges(k), k)])

        # Drop those that are settled
        faces = faces.select(slices.at(slices.settled, faces.points, faces.slices) == 0.0)
        for view in views:
            faces = faces.select(~faces.are_passed_in(view))
        for view in views:
            yaws = view.image.yaws
            ends = (float(np.min(yaws, initial=0.0)), float(np.max(yaws, initial=0.0)))
            faces = faces.select(~self._shown(faces, view.T_world_scan, ends))
        return faces

    def _edges(self, index: int) -> list[Edge]:
        """Return the edges of the target in slice ``index``, in ``world``."""
        edges = []
        for view, profiles in zip(self.session.views, self._profiles, strict=True):
            edges += [each.seen_from(view.T_world_scan) for each in profiles[index].edges]
        return merge_edges(edges)

    def measure_areas(self, poses: Iterable[Pose2]) -> FloatArray:
        """Return the foreshortened area of the hidden faces that each of ``poses`` shows (n,) [m2].

        The number of readings is proportional to the foreshortened area. Faces at a flat angle,
        whose visibility depends on a centimetre, count little.

        Args:
            poses: Viewpoints in ``world``.
        """
        shown = [(self.faces.select(self._shown(self.faces, pose)), pose) for pose in poses]
        cosines = np.array([faces.cosines(pose).sum() for faces, pose in shown])
        return SLICE_CELL * SLICE_THICKNESS * cosines

    def _shown(
        self, faces: Faces, pose: Pose2, ends: tuple[float, float] = (-math.inf, math.inf)
    ) -> BoolArray:
        """Return which ``faces`` (n,) a sweep at ``pose`` shows, between its ``ends`` [rad]."""
        # Check width, incidence and distance
        config = self.session.config
        half = config.sweep.width / 2
        ways = np.array([pose.x, pose.y]) - faces.points
        distance = np.linalg.norm(ways, axis=1)
        local = pose.inverse().apply(faces.points)
        bearings = np.arctan2(local[:, 1], local[:, 0])
        shown = (bearings >= max(ends[0], -half)) & (bearings <= min(ends[1], half))
        shown &= faces.cosines(pose) >= math.cos(MAX_INCIDENCE)
        shown &= distance <= 2 * config.planning.standoff

        # Drop those behind other surface
        hidden = self.slices.find_hidden(faces.select(shown), np.array([pose.x, pose.y]))
        shown[shown] = ~hidden
        return np.asarray(shown)


def _recall_profiles(view: View, workspace: Workspace) -> list[Profile]:
    """Return the profiles of ``view``, one for each slice, from ``workspace`` if they are there."""
    results = workspace.results_of(view.image)
    if Profile not in results or results[Profile][0] is not view.target:
        results[Profile] = view.target, Profile.through(view, SLICE_HEIGHTS, SLICE_THICKNESS)
    profiles: list[Profile] = results[Profile][1]
    return profiles


def _close_holes(grid: BoolArray) -> BoolArray:
    """Return the cells (nx, ny) of ``grid`` with small holes closed, but for the border.

    A morphological closing by a square of 3 x 3 cells.
    """
    return erode(dilate(grid, SQUARE_RADIUS), SQUARE_RADIUS)


def expect_faces(edges: Iterable[Edge], index: int) -> Iterator[Faces]:
    """Yield the face expected behind each of the ``edges`` in ``world`` of slice ``index``.

    It goes back at a right angle to the surface that ends there.
    """
    depth = np.arange(SLICE_CELL, FACE_DEPTH, SLICE_CELL)[:, None]
    for edge in edges:
        points = edge.place - depth * edge.normal
        normals = np.tile(edge.onwards, (len(points), 1))
        yield Faces(points, normals, np.full(len(points), index))


def merge_edges(edges: Iterable[Edge]) -> list[Edge]:
    """Return each edge once, as it was seen best."""
    kept: list[Edge] = []
    for edge in sorted(edges, key=lambda each: each.spacing):
        if not any(_is_same_edge(edge, other) for other in kept):
            kept.append(edge)
    return kept


def _is_same_edge(a: Edge, b: Edge) -> bool:
    apart = float(np.linalg.norm(a.place - b.place))
    return apart <= SAME_EDGE_DISTANCE and float(a.onwards @ b.onwards) >= math.cos(SAME_EDGE_ANGLE)
