"""The fused cloud: the target points of all views in one frame, cleaned, weighted and fused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from scan3d_twin.core.display import render_html
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.scan_noise import estimate_noise
from scan3d_twin.core.scanning.mixed_pixels import MAX_INCIDENCE, RANGE_NOISE
from scan3d_twin.core.scanning.smoothing import smooth
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, read_only

SCANNED_DISTANCE = 0.10
"""Distance of a model point within which a point of the first panorama counts as scanned [m]."""
SECTORS = 36
"""Sectors around the target by which the progress of a tour all round is measured."""
NORMAL_NEIGHBOURS = 24
"""Number of neighbours through which the plane of a normal is fitted: 4 cm across at 1 m, where
5 mm of noise tilt it by 5 deg."""
MIN_SUPPORT = 3
"""Smallest number of the eight neighbours on one surface with a reading that is no outlier."""
MAX_SPREAD_INCIDENCE = math.radians(85.0)
"""Incidence from which on the spread of a beam on the surface is constant, to keep it finite
[rad]."""


@dataclass(frozen=True, eq=False)
class Model:
    """Oriented points with standard deviations.

    Attributes:
        points: Points in ``world`` (n, 3) [m].
        normals: Unit normals towards the lidar that saw the point (n, 3); NaN where unknown.
        sigma: Standard deviation along the beam, by noise only (n,) [m].
        view: Index of each point's view (n,); for a fused point, of the view with most weight.

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

    def _repr_html_(self) -> str | None:
        return render_html(self)

    def select(self, mask: BoolArray | IntArray) -> Model:
        """Return the points that a mask (n,) or an index (k,) selects."""
        return Model(*(getattr(self, each.name)[mask] for each in fields(self)))


@dataclass(frozen=True)
class ViewCloud:
    """The target points of one view.

    Attributes:
        model: All target points, including outliers.
        smoothed: The same points on the smoothed surface in ``world`` (n, 3) [m].
        supported: Which points are no outliers (n,); see ``find_supported``.
    """

    model: Model
    smoothed: FloatArray
    supported: BoolArray

    @property
    def cleaned(self) -> Model:
        """The target points without outliers."""
        return self.model.select(self.supported)


def build_model(session: Session, voxel: float = 0.0) -> Model:
    """Return the target points of all views without outliers.

    Args:
        session: The views.
        voxel: Side of the voxels in which points are fused [m]; 0 to fuse none.

    >>> len(s3d.build_model(session, voxel=0.02)) < len(s3d.build_model(session))
    True
    """
    model = join_models([each.cleaned for each in build_view_clouds(session)])
    return fuse_voxels(model, voxel) if voxel > 0 else model


def build_view_clouds(session: Session) -> list[ViewCloud]:
    """Return the target points of each view."""
    return [build_view_cloud(view, k) for k, view in enumerate(session.views)]


def join_models(models: Sequence[Model]) -> Model:
    """Return all points of ``models`` as one model."""
    if not models:
        return Model(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    return Model(
        *(np.concatenate([getattr(m, each.name) for m in models]) for each in fields(Model))
    )


def find_supported(view: View) -> BoolArray:
    """Return which target points (n,) of a view are no outliers.

    An outlier is not a point far from its neighbours, as those on a surface seen at a flat angle
    are, but one through which no surface passes to its neighbours in the range image; see
    ``native/readings.h``.
    """
    image, target = view.image, view.target
    ranges, counts = read_only(image.ranges), np.empty(len(target), dtype=np.int64)
    elevations = read_only(image.elevation_rows)
    engine.count_neighbours(
        ranges, read_only(image.yaws), elevations, len(elevations) > 1, *ranges.shape,
        np.ascontiguousarray(target.lines), np.ascontiguousarray(target.beams), len(target),
        RANGE_NOISE, math.tan(MAX_INCIDENCE), counts,
    )  # fmt: skip
    return np.asarray(counts >= MIN_SUPPORT)


def build_view_cloud(view: View, index: int = 0) -> ViewCloud:
    """Return the target points of view number ``index`` with normals and standard deviations.

    The variance of a reading at range r and incidence i is s(r)^2 + (r b tan i)^2: the noise, as
    the sweep itself shows it, and the spread of the beam on an oblique surface. A beam is uniform
    over the angle between two beams, so that b = angle / sqrt(12).
    """
    # Estimate normals on the smoothed surface
    target, image = view.target, view.image
    smoothed = target.with_points_of(smooth(image)).points
    rays = target.points - _find_eyes(view)
    r = np.linalg.norm(rays, axis=1)
    normals = estimate_normals(smoothed, -rays)

    # Add up noise and beam spread
    valid = np.isfinite(image.ranges)
    noise = estimate_noise(image, valid)
    beam = float(np.median(np.diff(image.spec.elevations))) / math.sqrt(12.0)
    cosine = -np.sum(rays * np.nan_to_num(normals), axis=1) / np.maximum(r, 1e-9)
    cosine = np.clip(cosine, math.cos(MAX_SPREAD_INCIDENCE), 1.0)
    spread = r * beam * np.sqrt(1.0 - cosine**2) / cosine
    sigma = np.hypot(noise.range_sigma + noise.range_sigma_per_metre * r, spread)

    # Place everything in the world
    model = Model(
        view.T_world_scan.apply(target.points),
        view.T_world_scan.rotate(normals),
        sigma,
        np.full(len(target), index),
    )
    return ViewCloud(model, view.T_world_scan.apply(smoothed), find_supported(view))


def _find_eyes(view: View) -> FloatArray:
    """Return the position of the lidar for each target point, in ``scan`` (n, 3) [m]."""
    image, lines, beams = view.image, view.target.lines, view.target.beams
    offset = image.ranges[lines, beams, None] * image.directions_at(lines, beams)
    return np.asarray(view.target.points - offset)


def estimate_normals(points: FloatArray, towards: FloatArray) -> FloatArray:
    """Return the unit normals (n, 3) of planes through ``NORMAL_NEIGHBOURS`` nearest points.

    Args:
        points: Points (n, 3) [m].
        towards: Directions on whose side the normals are (n, 3).

    Returns:
        The directions of least variance; NaN for fewer than 3 points.
    """
    if len(points) < 3:
        return np.full((len(points), 3), np.nan)
    _, normals, _ = Tree.of(np.ascontiguousarray(points)).fit_planes(
        min(NORMAL_NEIGHBOURS, len(points))
    )
    inward = np.sum(normals * towards, axis=1) < 0
    return np.asarray(np.where(inward[:, None], -normals, normals))


def fuse_voxels(model: Model, size: float) -> Model:
    """Return the inverse-variance weighted mean of each occupied voxel of side ``size`` [m].

    Its ``sigma`` is that of the mean of independent readings, 1 / sqrt(sum 1 / sigma^2), without
    the errors of a pose or of the lidar that readings share.
    """
    if len(model) == 0:
        return model

    # Weigh by inverse variance
    index = number_voxels(model.points, size)
    weight = model.sigma**-2
    total = np.asarray(np.bincount(index, weight), dtype=np.float64)
    known = np.nan_to_num(model.normals)

    # Average points and normals
    points = [np.bincount(index, weight * model.points[:, i]) / total for i in range(3)]
    normals = np.stack([np.bincount(index, weight * known[:, i]) for i in range(3)], axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.full_like(normals, np.nan), where=length > 0)
    return Model(
        np.stack(points, axis=1),
        normals,
        np.sqrt(1.0 / total),
        _find_heaviest_view(index, model.view, weight),
    )


def _find_heaviest_view(index: IntArray, view: IntArray, weight: FloatArray) -> IntArray:
    """Return the view with the most weight in each voxel (m,)."""
    pairs, where = np.unique(np.stack([index, view], axis=1), axis=0, return_inverse=True)
    order = np.lexsort((np.bincount(where, weight), pairs[:, 0]))
    last = np.flatnonzero(np.diff(pairs[order, 0], append=-1))
    return np.asarray(pairs[order[last], 1])


def thin_by_voxel(points: FloatArray, size: float) -> FloatArray:
    """Return the mean point (m, 3) of each occupied voxel of side ``size`` [m]."""
    if len(points) == 0:
        return points
    index = number_voxels(points, size)
    count = np.bincount(index)
    return np.stack([np.bincount(index, points[:, i]) / count for i in range(3)], axis=1)


def number_voxels(points: FloatArray, size: float) -> IntArray:
    """Return the voxel number (n,) of each of ``points`` (n, 3), for voxels of side ``size`` [m].

    The occupied voxels are numbered from 0 in the order of x, then y, then z.
    """
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    flat = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    return np.asarray(np.unique(flat, return_inverse=True)[1], dtype=np.int64)


def measure_scanned_share(session: Session) -> float:
    """Return the share of the target's outline that was scanned, as far as the robot knows, 0..1.

    On a tour of the front it is a share of the outline in the first panorama, on a tour all round
    of the sectors around the target's middle.
    """
    seen = [view.T_world_scan.apply(view.target.points)[:, :2] for view in session.views]
    model = np.concatenate([np.zeros((0, 2)), *seen])
    if len(model) == 0:
        return 0.0

    # Front: compare with the first panorama
    if session.config.tour == "front":
        distance, _ = Tree.of(model).closest(session.hint, SCANNED_DISTANCE)
        return float(np.mean(np.isfinite(distance)))

    # All round: count sectors
    middle = (model.min(axis=0) + model.max(axis=0)) / 2
    x, y = (model - middle).T
    sectors = np.floor((np.arctan2(y, x) / math.tau) % 1.0 * SECTORS).astype(np.int64)
    return len(np.unique(sectors)) / SECTORS
