"""Voxel map of the space around the target: free, occupied or unknown, by the robot's scans.

A voxel is occupied when it holds readings, and free when a beam passed it. A single missing reading
is no evidence; where many neighbours are missing, the beams met nothing in range or were absorbed,
and the space up to the maximum range counts as free. Rays from candidate viewpoints are marched
through the map to find what they would meet first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.moving_windows import open_by_box
from scan3d_twin.core.planning.surface.surface_patches import Eye
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import (
    UNMEASURED,
    BoolArray,
    FloatArray,
    IntArray,
    Pose2,
    RangeImage,
)

Labels = npt.NDArray[np.int8]
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
VOXEL_SIZE = 0.05
"""Side of a voxel [m]: six times the spacing of lines on a surface at 1 m."""
FLOOR_TOP = 0.05
"""Height below which is the floor [m]."""
HEADROOM = 0.25
"""Height of the map above the highest reading of the target [m]."""
MIN_VOXEL_READINGS = 2
"""Smallest number of readings in an occupied voxel; fewer are stray."""
BORDER_VOXELS = 3
"""Distance from the target, in voxels, within which unknown voxels may hold more of it: 0.15 m,
less than the distance of two targets (``target.cluster_gap``)."""
RAY_STEP = math.radians(3.0)
"""Angle between two rays [rad]: a voxel at 1 m."""
MIN_VOID_ANGLE = math.radians(3.0)
"""Width from which on a hole is no dropout [rad]; narrower ones are filled (``gaps.max_angle``)."""
RAY_START = 0.20
"""Distance from the axis at which rays start [m]: outside of the robot."""


@dataclass(frozen=True)
class VoxelMap:
    """The space around the target, in ``world``.

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
        """Unknown voxels at the target's border, which may hold more of it (nx, ny, nz)."""
        from scipy import ndimage  # slow to import

        near = ndimage.maximum_filter(self.target, 1 + 2 * BORDER_VOXELS, mode="constant")
        return np.asarray(near & (self.labels == UNKNOWN))

    def indices(self, points: FloatArray) -> IntArray:
        """Return the flat index of the voxel of each of ``points`` (..., 3); -1 outside."""
        cells = np.floor((points - self.origin) / VOXEL_SIZE).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < self.labels.shape), axis=-1)
        _, ny, nz = self.labels.shape
        flat = (cells[..., 0] * ny + cells[..., 1]) * nz + cells[..., 2]
        return np.asarray(np.where(inside, flat, -1))

    def march(self, pose: Pose2, eye: Eye, reach: float) -> Rays:
        """Return the voxels along the rays of a sweep at ``pose``, up to ``reach`` [m]."""
        directions = _sweep_directions(eye)
        steps = np.arange(RAY_START, reach, VOXEL_SIZE)
        start = np.array([pose.x, pose.y, eye.height])
        points = start + steps[:, None] * pose.rotate(directions)[:, None, :]
        index = self.indices(points)
        labels = np.where(index >= 0, self.labels.ravel()[index], FREE).astype(np.int8)
        return Rays(index, labels)


@dataclass(frozen=True)
class Rays:
    """The voxels along rays, nearest first; those outside of the map count as free.

    Attributes:
        index: Flat index of each voxel, -1 outside (n_rays, n_steps).
        labels: Label of each voxel (n_rays, n_steps).
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

    def count_met(self, mask: BoolArray) -> int:
        """Return the number of voxels of ``mask`` (nx, ny, nz) that the rays meet first."""
        hit = np.unique(self.first[self.first >= 0])
        return int(np.count_nonzero(mask.ravel()[hit]))


def build_voxel_map(session: Session, margin: float) -> VoxelMap:
    """Return the map of the space within ``margin`` [m] of the known target."""
    blank = _lay_out(session, margin)
    low, shape = blank.origin, blank.labels.shape

    # Mark voxels that beams passed
    free = np.zeros(shape, dtype=bool)
    centres = low + (np.moveaxis(np.indices(shape), 0, -1) + 0.5) * VOXEL_SIZE
    for T_world_scan, image in _iterate_images(session):
        free |= is_passed(T_world_scan.inverse().apply(centres), image, VOXEL_SIZE / 2)

    # Mark voxels that hold readings
    solid = _find_occupied(blank, [(v.T_world_scan, v.sweep.points) for v in session.views])
    target = _find_occupied(blank, [(v.T_world_scan, v.target.points) for v in session.views])
    labels = np.where(solid, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
    return VoxelMap(low, labels, target & solid)


def find_occupied_voxels(session: Session, margin: float) -> FloatArray:
    """Return the middles (n, 3) [m] of the occupied voxels of ``build_voxel_map``, without it."""
    blank = _lay_out(session, margin)
    solid = _find_occupied(blank, [(v.T_world_scan, v.sweep.points) for v in session.views])
    return np.asarray(blank.origin + (np.argwhere(solid) + 0.5) * VOXEL_SIZE)


def _lay_out(session: Session, margin: float) -> VoxelMap:
    """Return a map of the space within ``margin`` [m] of the known target, all unknown."""
    known = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
    hint = session.hint if len(known) == 0 else known[:, :2]
    low = np.append(hint.min(axis=0) - margin, FLOOR_TOP)
    top = float(known[:, 2].max()) if len(known) else 1.0
    high = np.append(hint.max(axis=0) + margin, top + HEADROOM)
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / VOXEL_SIZE))

    return VoxelMap(low, np.zeros((nx, ny, nz), np.int8), np.zeros((nx, ny, nz), dtype=bool))


def _iterate_images(session: Session) -> Iterator[tuple[Pose2, RangeImage]]:
    """Yield the images of all views, then of all panoramas, each with its pose in ``world``."""
    for view in session.views:
        yield view.T_world_scan, view.observation.image
    for taken, panorama in session.panoramas:
        if taken == 0:
            yield panorama.T_odom_scan, panorama.image
            continue
        view = session.views[min(taken, len(session.views)) - 1]
        yield view.T_world_odom @ panorama.T_odom_scan, panorama.image


def is_passed(points: FloatArray, image: RangeImage, clearly: float | FloatArray) -> BoolArray:
    """Return which ``points`` (...) a beam of ``image`` has passed.

    Args:
        points: Points in ``scan`` (..., 3) [m].
        image: The range image.
        clearly: Smallest distance of a point in front of the reading [m]; a number or (...).
    """
    # Express points as range and bearing
    lever, height = image.T_base_lidar[0, 3], image.T_base_lidar[2, 3]
    yaws = image.yaws[:, image.spec.n_beams // 2]
    flat = np.hypot(points[..., 0], points[..., 1]) - lever
    up = points[..., 2] - height
    middle = (yaws[0] + yaws[-1]) / 2
    bearing = np.arctan2(points[..., 1], points[..., 0])
    bearing = middle + (bearing - middle + np.pi) % math.tau - np.pi

    # Compare with the nearest beam
    line, off = _find_nearest_entry(-yaws, -bearing)
    beam, away = _find_nearest_beam(image, line, np.arctan2(up, flat))
    spacing = float(np.median(-np.diff(yaws)))
    reach = _measure_reach(image, spacing)
    seen = (off <= spacing) & (away <= math.radians(1.0)) & (flat > 0)
    with np.errstate(invalid="ignore"):
        before = np.hypot(flat, up) < reach[line, beam] - clearly
    return np.asarray(seen & before)


def _measure_reach(image: RangeImage, spacing: float) -> FloatArray:
    """Return the free length of each beam (n_lines, n_beams) [m]; NaN for a single dropout."""
    beams = float(np.median(np.diff(image.spec.elevations)))
    hole = np.isnan(image.ranges)
    wide = [max(1, round(MIN_VOID_ANGLE / step)) for step in (spacing, beams)]
    void = open_by_box(hole, wide)
    return np.where(hole & void, image.spec.max_range, image.ranges)


def _find_nearest_beam(
    image: RangeImage, line: IntArray, elevations: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the beam of each ``line`` nearest to ``elevations`` (...) [rad], and how far it is.

    Where lines have elevations of their own, it is one of the nominally nearest three.
    """
    own = image.elevations
    beam, away = _find_nearest_entry(image.spec.elevations, elevations)
    if own is None:
        return beam, away
    beside = np.clip(beam[..., None] + np.arange(-1, 2), 0, image.spec.n_beams - 1)
    off = np.abs(own[line[..., None], beside] - elevations[..., None])
    off[image.codes[line[..., None], beside] == UNMEASURED] = np.inf
    best = np.argmin(off, axis=-1)[..., None]
    beam, away = (np.take_along_axis(each, best, axis=-1)[..., 0] for each in (beside, off))
    return beam, away


def _find_nearest_entry(ascending: FloatArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the index of the entry nearest to each value, and its distance from the value."""
    right = np.clip(np.searchsorted(ascending, values), 1, len(ascending) - 1)
    left = right - 1
    nearer_left = values - ascending[left] < ascending[right] - values
    index = np.where(nearer_left, left, right)
    return index, np.abs(ascending[index] - values)


def _find_occupied(blank: VoxelMap, clouds: list[tuple[Pose2, FloatArray]]) -> BoolArray:
    """Return which voxels hold at least ``MIN_VOXEL_READINGS`` points of one of ``clouds``."""
    result = np.zeros(blank.labels.size, dtype=bool)
    for T, points in clouds:
        index = blank.indices(T.apply(points))
        count = np.bincount(index[index >= 0], minlength=blank.labels.size)
        result |= count >= MIN_VOXEL_READINGS
    return result.reshape(blank.labels.shape)


def _sweep_directions(eye: Eye) -> FloatArray:
    """Return the directions (n_rays, 3) of a coarse sweep."""
    yaw = _spread_angles(eye.half_width)
    elevation = _spread_angles(eye.half_window)
    a, e = (grid.ravel() for grid in np.meshgrid(yaw, elevation, indexing="ij"))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def _spread_angles(half: float) -> FloatArray:
    return np.linspace(-half, half, 2 * math.ceil(half / RAY_STEP) + 1)
