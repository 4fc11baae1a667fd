"""The model of the target: all views' target points in one frame, cleaned, weighed and fused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.registration.clouds import Tree
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.scan_noise import estimate_range_noise
from scan3d_twin.core.scanning.mixed_pixels import NOISE, STEEPEST
from scan3d_twin.core.scanning.smoothing import smooth
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, read_only

SEEN_DISTANCE = 0.10
"""What the look around found counts as scanned with a model point this near [m]."""
SECTORS = 36
"""Directions round the target, for a tour all round."""
PATCH = 24
"""Neighbours whose plane gives a normal: 4 cm across at 1 m, where 5 mm of noise tilt it 5 deg."""
SUPPORT = 3
"""A reading is an outlier when fewer of the eight beside it can lie on one surface with it."""
GRAZING = math.radians(85.0)
"""Incidence beyond which the spread of a beam on the surface grows no more; keeps it finite."""


@dataclass(frozen=True)
class Model:
    """Oriented points with what each is worth.

    Attributes:
        points: (n, 3) in ``world`` [m].
        normals: Unit normals towards the lidar that saw the point (n, 3); NaN where unknown.
        sigma: Standard deviation along the beam, by noise alone (n,) [m].
        view: Index of the view each point came from; of a fused one, the view that weighs most.

    >>> model = s3d.build_model(session)
    >>> model.points.shape == model.normals.shape, set(model.view.tolist()) == {0, 1}
    (True, True)
    """

    points: FloatArray
    normals: FloatArray
    sigma: FloatArray
    view: IntArray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, mask: BoolArray | IntArray) -> Model:
        """Return the points of a mask or an index."""
        return Model(*(getattr(self, each.name)[mask] for each in fields(self)))


@dataclass(frozen=True)
class Sighting:
    """What one view shows of the target.

    Attributes:
        model: All its target points, outliers among them.
        smoothed: The same points on the smoothed surface (n, 3) in ``world`` [m].
        supported: Which of them are no outliers (n,); see ``supported``.
    """

    model: Model
    smoothed: FloatArray
    supported: BoolArray

    @property
    def cleaned(self) -> Model:
        """Its points without outliers."""
        return self.model.select(self.supported)


def build_model(session: Session, voxel: float = 0.0) -> Model:
    """Return the target's points of all views without outliers.

    Fused in voxels of side ``voxel`` [m] unless it is 0.

    >>> len(s3d.build_model(session, voxel=0.02)) < len(s3d.build_model(session))
    True
    """
    model = joined([each.cleaned for each in sightings(session)])
    return fuse_voxels(model, voxel) if voxel > 0 else model


def sightings(session: Session) -> list[Sighting]:
    """Return what each view shows of the target."""
    return [sight(view, k) for k, view in enumerate(session.views)]


def joined(models: Sequence[Model]) -> Model:
    """Return all points of ``models`` as one."""
    if not models:
        return Model(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    return Model(
        *(np.concatenate([getattr(m, each.name) for m in models]) for each in fields(Model))
    )


def supported(view: View) -> BoolArray:
    """Tell which target points (n,) of a view are no outliers.

    Those are not the points that lie far apart, which are what a flat view of a surface gives, but
    those of which no surface passes through their neighbours on the grid of lines and beams; see
    ``native/readings.h``.
    """
    image, target = view.image, view.target
    ranges, counts = read_only(image.ranges), np.empty(len(target), dtype=np.int64)
    engine.count_neighbours(
        ranges, read_only(image.yaws), read_only(image.spec.elevations), *ranges.shape,
        np.ascontiguousarray(target.lines), np.ascontiguousarray(target.beams), len(target),
        NOISE, math.tan(STEEPEST), counts,
    )  # fmt: skip
    return np.asarray(counts >= SUPPORT)


def sight(view: View, index: int = 0) -> Sighting:
    """Return a view's target points with normals and standard deviations, as view ``index``.

    The variance of a reading at range r and incidence i is s(r)^2 + (r b tan i)^2: the noise that
    the sweep itself shows, and the spread of a beam of the angle between two beams, uniform, so
    b = angle / sqrt(12), on an oblique surface.
    """
    target, image = view.target, view.image
    smoothed = target.on(smooth(image)).points
    rays = target.points - _eyes(view)
    r = np.linalg.norm(rays, axis=1)
    normals = estimate_normals(smoothed, -rays)
    valid = np.isfinite(image.ranges)
    known = estimate_range_noise(image.ranges, valid)
    beam = float(np.median(np.diff(image.spec.elevations))) / math.sqrt(12.0)
    cosine = -np.sum(rays * np.nan_to_num(normals), axis=1) / np.maximum(r, 1e-9)
    cosine = np.clip(cosine, math.cos(GRAZING), 1.0)
    spread = r * beam * np.sqrt(1.0 - cosine**2) / cosine
    sigma = np.hypot(known[0] + known[1] * r, spread)
    model = Model(
        view.T_world_scan.apply(target.points),
        view.T_world_scan.rotate(normals),
        sigma,
        np.full(len(target), index),
    )
    return Sighting(model, view.T_world_scan.apply(smoothed), supported(view))


def _eyes(view: View) -> FloatArray:
    """Return where the lidar was for each target point, in ``scan`` (n, 3) [m]."""
    image, lines, beams = view.image, view.target.lines, view.target.beams
    offset = image.ranges[lines, beams, None] * image.directions_at(lines, beams)
    return np.asarray(view.target.points - offset)


def estimate_normals(points: FloatArray, towards: FloatArray) -> FloatArray:
    """Return the unit normal (n, 3) of the plane through each point's ``PATCH`` nearest points.

    Args:
        points: (n, 3) [m].
        towards: Directions (n, 3) on whose side the normals are to lie.

    Returns:
        The direction of least variance; NaN for fewer than 3 points.
    """
    if len(points) < 3:
        return np.full((len(points), 3), np.nan)
    _, normals, _ = Tree.of(np.ascontiguousarray(points)).fit_planes(min(PATCH, len(points)))
    inward = np.sum(normals * towards, axis=1) < 0
    return np.asarray(np.where(inward[:, None], -normals, normals))


def fuse_voxels(model: Model, size: float) -> Model:
    """Return one point for each occupied voxel of side ``size`` [m]: the mean, by inverse variance.

    Its ``sigma`` is that of the mean of independent readings, 1 / sqrt(sum 1 / sigma^2); errors
    that readings share, of a pose or of the lidar, are not in it.
    """
    if len(model) == 0:
        return model
    index = _voxels(model.points, size)
    weight = model.sigma**-2
    total = np.asarray(np.bincount(index, weight), dtype=np.float64)
    known = np.nan_to_num(model.normals)
    points = [np.bincount(index, weight * model.points[:, i]) / total for i in range(3)]
    normals = np.stack([np.bincount(index, weight * known[:, i]) for i in range(3)], axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.full_like(normals, np.nan), where=length > 0)
    return Model(
        np.stack(points, axis=1),
        normals,
        np.sqrt(1.0 / total),
        _heaviest(index, model.view, weight),
    )


def _heaviest(index: IntArray, view: IntArray, weight: FloatArray) -> IntArray:
    """Return the view that weighs most in each voxel (m,)."""
    pairs, where = np.unique(np.stack([index, view], axis=1), axis=0, return_inverse=True)
    order = np.lexsort((np.bincount(where, weight), pairs[:, 0]))
    last = np.flatnonzero(np.diff(pairs[order, 0], append=-1))
    return np.asarray(pairs[order[last], 1])


def voxel_thin(points: FloatArray, size: float) -> FloatArray:
    """Return the mean point (m, 3) of each occupied voxel of side ``size`` [m]."""
    if len(points) == 0:
        return points
    index = _voxels(points, size)
    count = np.bincount(index)
    return np.stack([np.bincount(index, points[:, i]) / count for i in range(3)], axis=1)


def _voxels(points: FloatArray, size: float) -> IntArray:
    """Return the number of the voxel of side ``size`` [m] in which each of ``points`` (n, 3) lies.

    The occupied ones are numbered from 0 in the order of x, then y, then z.
    """
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    flat = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    return np.asarray(np.unique(flat, return_inverse=True)[1], dtype=np.int64)


def scanned_share(session: Session) -> float:
    """Return how much of the target's outline has been scanned, as far as the robot can know, 0..1.

    The front: of what the first look around found. All round: of the directions round its middle.
    """
    seen = [view.T_world_scan.apply(view.target.points)[:, :2] for view in session.views]
    model = np.concatenate([np.zeros((0, 2)), *seen])
    if len(model) == 0:
        return 0.0
    if session.config.tour == "front":
        distance, _ = nearest(cKDTree(model), session.hint, SEEN_DISTANCE)
        return float(np.mean(np.isfinite(distance)))
    middle = (model.min(axis=0) + model.max(axis=0)) / 2
    x, y = (model - middle).T
    sectors = np.floor((np.arctan2(y, x) / math.tau) % 1.0 * SECTORS).astype(np.int64)
    return len(np.unique(sectors)) / SECTORS
