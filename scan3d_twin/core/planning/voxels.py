"""What is known of the space around the target: free, occupied or unknown, from the robot's scans.

A voxel is occupied when readings lie in it, and free when a beam passed it. A single reading that
did not come back says nothing; where many neighbours did not, the beams met nothing in range, or
what swallows them, and the space up to there counts as free. Rays from a viewpoint to come are
marched through the map to see what they would meet first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from scan3d_twin.core.planning.surface_patches import Eye
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2, RangeImage

Labels = npt.NDArray[np.int8]
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
VOXEL = 0.05
"""Side of a voxel [m]: what one line and the next see of a surface at 1 m is a sixth of it."""
LOWEST = 0.05
"""Below lies the floor [m]."""
HEADROOM = 0.25
"""The map ends so far above the highest reading of the target [m]."""
MIN_READINGS = 2
"""Fewer readings in a voxel are stray."""
BESIDE = 3
"""Unknown voxels within so many voxels of the target's may hold more of it; 0.15 m, less than what
separates two targets (``target.cluster_gap``)."""
RAY_STEP = math.radians(3.0)
"""Between two rays [rad]: a voxel at 1 m."""
VOID = math.radians(3.0)
"""A hole at least so wide is no dropout [rad]; narrower ones are filled (``gaps.max_angle``)."""
NEAREST = 0.20
"""Rays begin so far from the axis [m]: outside of the robot."""


@dataclass(frozen=True)
class VoxelMap:
    """Space around the target, in ``world``.

    Attributes:
        origin: Corner of voxel (0, 0, 0) (3,) [m].
        labels: ``UNKNOWN``, ``FREE`` or ``OCCUPIED`` (nx, ny, nz).
        target: Voxels that hold readings of the target (nx, ny, nz).
    """

    origin: FloatArray
    labels: Labels
    target: BoolArray

    @cached_property
    def may_hold_more(self) -> BoolArray:
        """Unknown voxels in which the target's surface may go on (nx, ny, nz)."""
        near = ndimage.maximum_filter(self.target, 1 + 2 * BESIDE, mode="constant")
        return np.asarray(near & (self.labels == UNKNOWN))

    def indices(self, points: FloatArray) -> IntArray:
        """Return the flat index of the voxel of each of ``points`` (..., 3); -1 outside."""
        cells = np.floor((points - self.origin) / VOXEL).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < self.labels.shape), axis=-1)
        _, ny, nz = self.labels.shape
        flat = (cells[..., 0] * ny + cells[..., 1]) * nz + cells[..., 2]
        return np.asarray(np.where(inside, flat, -1))

    def march(self, pose: Pose2, eye: Eye, reach: float) -> Rays:
        """Return what rays of a sweep at ``pose`` meet within ``reach`` [m]."""
        directions = _directions(eye)
        steps = np.arange(NEAREST, reach, VOXEL)
        start = np.array([pose.x, pose.y, eye.height])
        points = start + steps[:, None] * pose.rotate(directions)[:, None, :]
        index = self.indices(points)
        labels = np.where(index >= 0, self.labels.ravel()[index], FREE).astype(np.int8)
        return Rays(index, labels)


@dataclass(frozen=True)
class Rays:
    """Voxels along rays, nearest first; what lies outside of the map counts as free.

    Attributes:
        index: Flat index of each voxel, -1 outside (n_rays, n_steps).
        labels: (n_rays, n_steps).
    """

    index: IntArray
    labels: Labels

    @cached_property
    def first(self) -> IntArray:
        """Flat index of the first voxel of each ray that is not free (n_rays,); -1 for none."""
        stops = self.labels != FREE
        where = np.argmax(stops, axis=1)
        found = np.take_along_axis(self.index, where[:, None], axis=1)[:, 0]
        return np.where(stops.any(axis=1), found, -1)

    def met(self, mask: BoolArray) -> int:
        """Return how many different voxels of ``mask`` (nx, ny, nz) the rays meet first."""
        hit = np.unique(self.first[self.first >= 0])
        return int(np.count_nonzero(mask.ravel()[hit]))


def voxel_map(session: Session, margin: float) -> VoxelMap:
    """Return the map of the space within ``margin`` [m] of what is known of the target."""
    known = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
    hint = session.hint if len(known) == 0 else known[:, :2]
    low = np.append(hint.min(axis=0) - margin, LOWEST)
    top = float(known[:, 2].max()) if len(known) else 1.0
    high = np.append(hint.max(axis=0) + margin, top + HEADROOM)
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / VOXEL))
    shape = (nx, ny, nz)
    empty = np.zeros(shape, dtype=np.int8)
    blank = VoxelMap(low, empty, empty.astype(bool))
    free = np.zeros(shape, dtype=bool)
    centres = low + (np.moveaxis(np.indices(shape), 0, -1) + 0.5) * VOXEL
    for T_world_scan, image in _images(session):
        free |= passed(T_world_scan.inverse().apply(centres), image, VOXEL / 2)
    solid = _occupied(blank, [(v.T_world_scan, v.sweep.points) for v in session.views])
    target = _occupied(blank, [(v.T_world_scan, v.target.points) for v in session.views])
    labels = np.where(solid, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
    return VoxelMap(low, labels, target & solid)


def _images(session: Session) -> Iterator[tuple[Pose2, RangeImage]]:
    """Yield all views, then all looks around, each placed in ``world``."""
    for view in session.views:
        yield view.T_world_scan, view.observation.image
    for taken, look in session.panoramas:
        if taken == 0:
            yield look.T_odom_scan, look.image
            continue
        view = session.views[min(taken, len(session.views)) - 1]
        move = view.observation.T_odom_scan.inverse() @ look.T_odom_scan
        yield view.T_world_scan @ move, look.image


def passed(points: FloatArray, image: RangeImage, clearly: float | FloatArray) -> BoolArray:
    """Tell which ``points`` (..., 3) in ``scan`` lie before what ``image`` measured.

    By at least ``clearly`` [m], one for all or one each (...).
    """
    lever, height = image.T_base_lidar[0, 3], image.T_base_lidar[2, 3]
    yaws = image.yaws[:, image.spec.n_beams // 2]
    flat = np.hypot(points[..., 0], points[..., 1]) - lever
    up = points[..., 2] - height
    middle = (yaws[0] + yaws[-1]) / 2
    bearing = np.arctan2(points[..., 1], points[..., 0])
    bearing = middle + (bearing - middle + np.pi) % math.tau - np.pi
    line, off = _nearest(-yaws, -bearing)
    beam, away = _nearest(image.spec.elevations, np.arctan2(up, flat))
    spacing = float(np.median(-np.diff(yaws)))
    reach = _reach(image, spacing)
    seen = (off <= spacing) & (away <= math.radians(1.0)) & (flat > 0)
    with np.errstate(invalid="ignore"):
        before = np.hypot(flat, up) < reach[line, beam] - clearly
    return np.asarray(seen & before)


def _reach(image: RangeImage, spacing: float) -> FloatArray:
    """Return how far each beam saw (n_lines, n_beams) [m]; NaN where a single one saw nothing."""
    beams = float(np.median(np.diff(image.spec.elevations)))
    hole = np.isnan(image.ranges)
    # An opening by a box; along one axis after the other takes a quarter of the time.
    wide = [max(1, round(VOID / step)) for step in (spacing, beams)]
    mirrored = [n % 2 - 1 for n in wide]
    eroded = ndimage.minimum_filter(hole, wide, mode="constant", cval=1)
    void = ndimage.maximum_filter(eroded, wide, mode="constant", cval=0, origin=mirrored)
    return np.where(hole & void, image.spec.max_range, image.ranges)


def _nearest(ascending: FloatArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the index of the entry nearest to each value, and how far it is off."""
    right = np.clip(np.searchsorted(ascending, values), 1, len(ascending) - 1)
    left = right - 1
    nearer_left = values - ascending[left] < ascending[right] - values
    index = np.where(nearer_left, left, right)
    return index, np.abs(ascending[index] - values)


def _occupied(blank: VoxelMap, clouds: list[tuple[Pose2, FloatArray]]) -> BoolArray:
    """Tell which voxels hold at least ``MIN_READINGS`` of one of the ``clouds``."""
    result = np.zeros(blank.labels.size, dtype=bool)
    for T, points in clouds:
        index = blank.indices(T.apply(points))
        count = np.bincount(index[index >= 0], minlength=blank.labels.size)
        result |= count >= MIN_READINGS
    return result.reshape(blank.labels.shape)


def _directions(eye: Eye) -> FloatArray:
    """Return the directions (n_rays, 3) of a coarse sweep."""
    yaw = _spread(eye.half_width)
    elevation = _spread(eye.half_window)
    a, e = (grid.ravel() for grid in np.meshgrid(yaw, elevation, indexing="ij"))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def _spread(half: float) -> FloatArray:
    return np.linspace(-half, half, 2 * math.ceil(half / RAY_STEP) + 1)
