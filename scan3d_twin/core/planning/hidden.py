"""What the target still hides: faces behind its edges that no view has shown.

The contour spans every niche and gap (``viewpoints``), so that a finished contour may hide surface
in them. Where a view saw the target end at an upright edge (``registration.edges``), a face is
expected to go back from it at a right angle to the surface that ends there, as the forecast of
registrations has it too. What is left of such faces where surface was seen, where beams passed, or
where a viewpoint that was taken should have shown it, is hidden.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.placing import surfels_of
from scan3d_twin.core.planning.voxels import passed
from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.registration.surfels import N, X
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
CARRIES = 0.25
"""Surface this near to an edge tells how the surface lies that ends there [m]; a few windows."""
SEEN = 0.03
"""Surface or a beam this near settles what is there [m]: a few sigma of the noise."""
THROUGH = 0.08
"""A beam that goes on for so long behind a reading passed it [m]: more than a surface seen at 75
deg recedes from one line to the next."""
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

    def select(self, mask: BoolArray) -> Faces:
        """Return the pieces where ``mask`` (n,) is True."""
        return Faces(self.points[mask], self.normals[mask], self.slices[mask])


@dataclass(frozen=True)
class Slices:
    """Cells in which surface of the target was seen, in ``world``.

    Attributes:
        origin: Corner of cell (0, 0) (2,) [m].
        surface: Small holes closed (n_slices, nx, ny).
        solid: The same without cells that a beam passed: noise before a surface (n_slices, nx, ny).
    """

    origin: FloatArray
    surface: BoolArray
    solid: BoolArray

    @staticmethod
    def of(session: Session) -> Slices:
        """Return the slices through the target of ``session``."""
        points = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
        low, high = points[:, :2].min(axis=0) - DEPTH, points[:, :2].max(axis=0) + DEPTH
        cells = np.floor((points[:, :2] - low) / CELL).astype(np.int64)
        shape = np.ceil((high - low) / CELL).astype(np.int64)
        surface = np.zeros((len(HEIGHTS), *shape), dtype=bool)
        for index, height in enumerate(HEIGHTS):
            near = np.abs(points[:, 2] - height) <= THICKNESS / 2
            surface[index, cells[near, 0], cells[near, 1]] = True
        surface = ndimage.binary_closing(surface, np.ones((1, 3, 3), dtype=bool))
        k, i, j = np.nonzero(surface)
        middles = low + (np.column_stack([i, j]) + 0.5) * CELL
        solid = surface.copy()
        middles = np.column_stack([middles, np.array(HEIGHTS)[k]])
        solid[k, i, j] = ~was_passed(middles, session, THROUGH)
        return Slices(low, surface, solid)

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
        met = self.at(self.solid, points, faces.slices[:, None]) > 0
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
    def _slices(self) -> Slices:
        return Slices.of(self.session)

    @cached_property
    def faces(self) -> Faces:
        """Those that no view so far has settled."""
        views, slices = self.session.views, self._slices
        faces = Faces.joined([each for view in views for each in expected(view, self.session)])
        faces = faces.select(slices.at(slices.distance, faces.points, faces.slices) > SEEN)
        cells = np.column_stack([np.floor(faces.points / CELL), faces.slices])
        _, first = np.unique(cells, axis=0, return_index=True)
        faces = faces.select(np.isin(np.arange(len(faces)), first))
        points = np.column_stack([faces.points, np.array(HEIGHTS)[faces.slices]])
        faces = faces.select(~was_passed(points, self.session, SEEN))
        for view in views:
            faces = faces.select(~self._shown(faces, view.T_world_scan))
        return faces

    def areas(self, poses: Iterable[Pose2]) -> FloatArray:
        """Return how much of the hidden faces each of ``poses`` in ``world`` shows (n,) [m2]."""
        shown = [np.count_nonzero(self._shown(self.faces, pose)) for pose in poses]
        return CELL * THICKNESS * np.array(shown, dtype=np.float64)

    def _shown(self, faces: Faces, pose: Pose2) -> BoolArray:
        """Tell which ``faces`` (n,) a sweep at ``pose`` shows."""
        config = self.session.config
        ways = np.array([pose.x, pose.y]) - faces.points
        distance = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        local = pose.inverse().apply(faces.points)
        shown = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= config.sweep.width / 2
        shown &= np.sum(ways * faces.normals, axis=1) >= math.cos(FLATTEST) * distance
        shown &= distance <= 2 * config.planning.standoff
        hidden = self._slices.hides(faces.select(shown), np.array([pose.x, pose.y]))
        shown[shown] = ~hidden
        return np.asarray(shown)


def was_passed(points: FloatArray, session: Session, clearly: float) -> BoolArray:
    """Tell which ``points`` (n, 3) in ``world`` a beam of a view passed by ``clearly`` [m]."""
    free = np.zeros(len(points), dtype=bool)
    for view in session.views:
        local = view.T_world_scan.inverse().apply(points)
        free |= passed(local, view.observation.image, clearly)
    return free


def expected(view: View, session: Session) -> Iterator[Faces]:
    """Yield the faces that are expected behind the edges of the target in ``view``."""
    try:
        grid = surfels_of(view, session.config)
    except RegistrationError:
        return
    if len(grid.edges) == 0 or len(view.target) == 0:
        return
    distance, _ = nearest(cKDTree(view.target.points[:, :2]), grid.edges.places)
    depth = np.arange(CELL, DEPTH, CELL)
    for k in np.flatnonzero(distance <= SEEN):
        inwards, normal = _behind(grid, int(k))
        points = view.T_world_scan.apply(grid.edges.places[k] + depth[:, None] * inwards)
        normals = np.tile(view.T_world_scan.rotate(normal), (len(points), 1))
        low, high = grid.edges.heights[k] + (-SEEN, SEEN)
        for j, height in enumerate(HEIGHTS):
            if low <= height <= high:
                yield Faces(points, normals, np.full(len(points), j))


def _behind(grid: SurfelGrid, k: int) -> tuple[FloatArray, FloatArray]:
    """Return how the face behind edge ``k`` goes back (2,) and its outward normal (2,).

    Back against the normal of the surface that ends there, the median of what is near: windows at
    the edge itself lean.
    """
    rows, edges = grid.sample(2).rows, grid.edges
    place, side, heights = edges.places[k], edges.sides[k], edges.heights[k]
    right = np.array([place[1], -place[0]]) / np.linalg.norm(place)
    offset = rows[:, :2] - place
    distance = np.linalg.norm(offset, axis=1)
    z = rows[:, X][:, 2]
    near = (distance <= CARRIES) & (side * (offset @ right) < 0)
    near &= (z >= heights[0] - SEEN) & (z <= heights[1] + SEEN)
    if not near.any():
        near = distance == distance.min()
    normals = rows[near, N]
    angle = float(np.median(np.arctan2(normals[:, 1], normals[:, 0])))
    inwards = -np.array([math.cos(angle), math.sin(angle)])
    outwards = np.array([inwards[1], -inwards[0]])
    return inwards, outwards * np.sign(side * (outwards @ right))
