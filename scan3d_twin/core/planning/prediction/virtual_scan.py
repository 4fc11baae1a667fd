"""Virtual scans: what a sweep would read of the surfaces that the latest view has seen.

The surfaces are planes fitted to that view over windows that are wide enough to average its noise
out, as two real scans do not share their noise. From a viewpoint O2 each reading of the next sweep
meets the nearest plane that faces it (splatting with a depth test). Surface that is hidden or was
never seen stays unknown; a ray is empty only where the latest view saw through. Each draw reads
these planes anew with range noise, a bias that neighbouring readings share, the yaw jitter of the
lines and the scale of all yaws, all as strong as registration assumes them to be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from scan3d_twin.core.moving_windows import moving_mean
from scan3d_twin.core.planning.surface.visibility import NextSweep, find_visible, measure_ranges
from scan3d_twin.core.registration import SurfelGrid, extract_surfels
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.extraction import (
    EMPTY_RAY,
    SURFACE_RAY,
    UNKNOWN_RAY,
    Beams,
    N,
    X,
    fit_surfels,
    make_native_sweep,
)
from scan3d_twin.core.registration.surfels.scan_noise import BIAS_PATCH, CURVE_RANGES, ScanNoise
from scan3d_twin.core.types import (
    VALID,
    BoolArray,
    FloatArray,
    IntArray,
    Pose2,
    RangeImage,
    read_only,
)

WINDOWS = tuple(
    (math.radians(lines), math.radians(beams))
    for lines, beams in ((6, 6), (4, 4), (2, 2), (0, 6), (0, 4), (1, 1), (0, 2), (0, 0))
)
"""Half sizes of the windows to which planes are fitted, along lines and beams [rad]: up to three
times those of registration, whose normals have 81 times the variance; upright windows are for
narrow faces."""
MAX_HALF_WINDOW = 20
"""Largest number of readings in half a window."""
NEIGHBOUR_OFFSETS = ((0, 1), (0, -1), (1, 0), (-1, 0))
FILL_ROUNDS = 2
"""Rounds in which readings without a plane take over that of a neighbour, as needed by nearer
viewpoints."""
FOOTPRINT_SPACINGS = 1.5
"""Extent of a plane around its point, in spacings of its readings."""
FREE_RAY_STRIDE = 3
"""Stride in lines and beams of the rays that are tested for free space."""
FREE_RAY_STEPS = 12
"""Number of places tested along such a ray."""
FREE_MARGIN = 0.05
"""Distance in front of a surface from which on space is free [m]."""


@dataclass(frozen=True)
class DrawnNoise:
    """The noise of the sweeps of one draw.

    Attributes:
        assumed: Standard deviations, as registration assumes them.
        yaw_scale: Relative error of all yaws of the robot.
        curve: Range error at ``CURVE_RANGES``, the same in both scans (k,) [m].
    """

    assumed: ScanNoise
    yaw_scale: float = 0.0
    curve: FloatArray = field(default_factory=lambda: np.zeros(len(CURVE_RANGES)))

    @staticmethod
    def draw(assumed: ScanNoise, rng: np.random.Generator) -> DrawnNoise:
        """Return what all sweeps of one draw have in common."""
        yaw_scale = assumed.yaw_scale_sigma * rng.standard_normal()
        half = np.linalg.cholesky(assumed.curve_covariance)
        return DrawnNoise(assumed, yaw_scale, half @ rng.standard_normal(len(half)))

    def yaws(self, yaws: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return drawn true yaws (n_lines, n_beams) [rad] for ``yaws`` by odometry."""
        jitter = self.assumed.yaw_sigma * rng.standard_normal((len(yaws), 1))
        return np.asarray(yaws * (1.0 + self.yaw_scale) + jitter)

    def ranges(self, image: RangeImage, rng: np.random.Generator) -> FloatArray:
        """Return the ranges of ``image`` with noise (n_lines, n_beams) [m]."""
        assumed, ranges = self.assumed, image.ranges
        sigma = assumed.range_sigma + assumed.range_sigma_per_metre * ranges
        noise = _correlate(rng.standard_normal(ranges.shape), assumed.correlation)
        shared = np.interp(ranges, CURVE_RANGES, self.curve)
        shared += assumed.bias_sigma * _draw_bias_field(image, rng)
        return np.asarray(ranges + sigma * noise + shared)


def _correlate(white: FloatArray, factor: float) -> FloatArray:
    """Return noise (n_lines, n_beams) whose mean along a line varies ``factor`` times as much.

    A moving mean over that many beams, rounded, of the same variance as ``white``.
    """
    beams = max(1, round(factor))
    if beams == 1:
        return white
    return np.asarray(math.sqrt(beams) * moving_mean(white, beams, axis=1))


def _draw_bias_field(image: RangeImage, rng: np.random.Generator) -> FloatArray:
    """Return a smooth random field (n_lines, n_beams) of mean variance 1.

    It interpolates between independent nodes at distances of ``BIAS_PATCH``, which leaves on
    average (2/3)^2 of their variance.
    """
    # Draw nodes over the sweep
    yaws, elevations = image.yaws[:, image.spec.n_beams // 2], image.spec.elevations
    line = np.abs(yaws - yaws[0]) / BIAS_PATCH
    beam = np.abs(elevations - elevations[0]) / BIAS_PATCH
    nodes = rng.standard_normal((int(line.max()) + 2, int(beam.max()) + 2))

    # Interpolate along lines and beams
    i, j = line.astype(np.int64), beam.astype(np.int64)
    u, v = (line - i)[:, None], beam - j
    rows = nodes[i] * (1 - u) + nodes[i + 1] * u
    return np.asarray(1.5 * (rows[:, j] * (1 - v) + rows[:, j + 1] * v))


@dataclass(frozen=True)
class Planes:
    """The plane that each reading of a sweep meets.

    Attributes:
        image: The sweep's lines and beams; the ranges do not matter.
        met: Which readings meet a plane (n_lines, n_beams), k of them.
        normals: Unit normals of these planes, in the frame of the image (k, 3).
        offsets: Their distances from its origin along the normals (k,) [m].
        keep: Readings that registration may use (n_lines, n_beams).
        on_target: Readings of the target (n_lines, n_beams).
        empty: Readings that are certain to return nothing (n_lines, n_beams).
    """

    image: RangeImage
    met: BoolArray
    normals: FloatArray
    offsets: FloatArray
    keep: BoolArray
    on_target: BoolArray
    empty: BoolArray

    def read(self, noise: DrawnNoise, rng: np.random.Generator) -> SurfelGrid:
        """Return the surfels of one noisy sweep.

        Raises:
            RegistrationError: Too little surface is in view.
        """
        # Draw true yaws and ranges
        true = replace(self.image, yaws=read_only(noise.yaws(self.image.yaws, rng)))
        ranges = noise.ranges(replace(true, ranges=read_only(self.ranges(true))), rng)

        # Extract surfels of the noisy sweep
        valid = self.met & (ranges > true.spec.min_range)
        seen = replace(
            self.image,
            ranges=read_only(np.where(valid, ranges, np.nan)),
            codes=read_only(np.where(valid, VALID, 0), np.int64),
        )
        grid = extract_surfels(seen, keep=self.keep & valid, noise=noise.assumed)
        return replace(grid, valid=valid | ~(self.met | self.empty))

    def ranges(self, image: RangeImage) -> FloatArray:
        """Return the ranges (n_lines, n_beams) [m] at which rays of ``image`` meet the planes."""
        ranges, normals = np.full(self.met.shape, np.nan), np.ascontiguousarray(self.normals)
        engine.meet_planes(*_list_rays(image, self.met), normals, self.offsets, ranges)
        return ranges

    def where(self, kept: BoolArray) -> Planes:
        """Return the planes that are ``kept`` (k,)."""
        met = self.met.copy()
        met[self.met] = kept
        normals, offsets = self.normals[kept], self.offsets[kept]
        keep, on_target = self.keep & met, self.on_target & met
        return Planes(self.image, met, normals, offsets, keep, on_target, self.empty)


def _list_rays(image: RangeImage, where: BoolArray) -> tuple[Any, ...]:
    """Return the rays ``where`` (n_lines, n_beams) is True as the engine takes them.

    That is their flat index, its length, the beams of a line, cosine and sine of their yaws, the
    beams' directions, whether each line has its own, and the lidar's position.
    """
    index, yaws, beams = np.flatnonzero(where), image.yaws[where], Beams.of(image)
    rays = beams.directions
    n_beams = image.spec.n_beams
    return index, len(index), n_beams, np.cos(yaws), np.sin(yaws), rays, rays.ndim == 3, beams.lever


def _cast_rays(image: RangeImage, where: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions (k, 3) of the rays ``where`` (n_lines, n_beams) is True."""
    yaws, rays = image.yaws[where], Beams.of(image).at(*np.nonzero(where))
    c, s = np.cos(yaws), np.sin(yaws)

    def turned(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        return np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, c.shape)], axis=1)

    return turned(*image.T_base_lidar[:3, 3]), turned(*rays.T)


@dataclass(frozen=True)
class Surface:
    """The surfaces that the latest view shows.

    Attributes:
        grid: Surfels of the latest view, in the scope of registration.
        on_target: Its readings of the target (n_lines, n_beams).
        most: Longest range that is trusted [m].
    """

    grid: SurfelGrid
    on_target: BoolArray
    most: float

    @cached_property
    def here(self) -> Planes:
        """The planes that a sweep from the latest viewpoint would read."""
        image, (rows, there) = self.grid.image, self._planes
        empty = (self.grid.ray_states == EMPTY_RAY).reshape(there.shape)
        offsets = np.sum(rows[:, N] * rows[:, X], axis=1)
        return Planes(
            image, there, rows[:, N], offsets, self._in_scope & there, self.on_target & there, empty
        )

    def seen_from(self, viewpoint: Pose2, sweep: NextSweep) -> Planes:
        """Return the planes that a ``sweep`` at ``viewpoint`` would read.

        Args:
            viewpoint: O2 in frame ``scan`` of the latest view.
            sweep: The next sweep.
        """
        # Find the planes in view
        back = viewpoint.inverse()
        shape = sweep.image.ranges.shape
        rows, scope, on_target = self._rows
        seen = find_visible(rows, self._ranges, viewpoint, sweep, self.most)
        points, normals = back.apply(rows[seen.index, X]), back.rotate(rows[seen.index, N])

        # Give each reading the nearest one
        owner = np.full(sweep.image.ranges.size, -1)
        far_first = np.argsort(-seen.ranges)
        owner[sweep.cells(points)[0][far_first]] = far_first
        owner = _fill_holes(owner.reshape(shape), seen.ranges)
        met, keep = owner >= 0, np.zeros((2, *shape), dtype=bool)

        # Describe the planes met
        own = owner[met]
        points, normals = points[own], normals[own]
        for flags, each in zip(keep, (scope, on_target), strict=True):
            flags[met] = each[seen.index[own]]

        # Drop readings far from their plane
        offsets = np.sum(normals * points, axis=1)
        planes = Planes(sweep.image, met, normals, offsets, keep[0], keep[1], ~met)
        planes = planes.where(_find_near(planes, points, seen.ranges[own], self.grid.line_spacing))
        return replace(planes, empty=~planes.met & self._seen_through(viewpoint, sweep.image))

    @cached_property
    def _planes(self) -> tuple[FloatArray, BoolArray]:
        """Planes fitted to the readings of any scope (n, 8), and which readings have one."""
        image, noise = self.grid.image, self.grid.noise
        steps = np.array([self.grid.line_spacing, Beams.of(image).spacing])
        halves = np.clip(np.round(np.array(WINDOWS) / steps), 1, MAX_HALF_WINDOW)
        valid = self.grid.valid
        rows, _, index = fit_surfels(
            make_native_sweep(image), valid, valid, noise.values, halves.astype(np.int64)
        )
        return rows, np.asarray(index >= 0)

    @cached_property
    def _in_scope(self) -> BoolArray:
        return np.asarray((self.grid.ray_states == SURFACE_RAY).reshape(self.grid.valid.shape))

    @cached_property
    def _rows(self) -> tuple[FloatArray, BoolArray, BoolArray]:
        """The planes as rows (n, 8), and which of them are in scope and of the target (n,)."""
        rows, there = self._planes
        return rows, self._in_scope[there], self.on_target[there]

    @cached_property
    def _ranges(self) -> FloatArray:
        return measure_ranges(self._rows[0], self.grid)

    def _seen_through(self, viewpoint: Pose2, image: RangeImage) -> BoolArray:
        """Return which rays of ``image`` from ``viewpoint`` the latest view saw to be free."""
        # Choose rays with a stride
        grid = self.grid
        at = np.s_[FREE_RAY_STRIDE // 2 :: FREE_RAY_STRIDE, FREE_RAY_STRIDE // 2 :: FREE_RAY_STRIDE]
        chosen = np.zeros(image.ranges.shape, dtype=bool)
        chosen[at] = True
        eyes, rays = _cast_rays(image, chosen)

        # Test places along them
        free = np.ones(image.ranges[at].shape, dtype=bool)
        known, row_of = grid.ray_states, grid.index.reshape(-1)
        for way in np.linspace(0.5, self.most, FREE_RAY_STEPS):
            places = viewpoint.apply(eyes + way * rays)
            index = grid.projection.lookup(places, known != UNKNOWN_RAY)
            rows = grid.rows[row_of[index]]
            before = np.sum(rows[:, N] * (places - rows[:, X]), axis=1) > FREE_MARGIN
            through = (known[index] == EMPTY_RAY) | ((known[index] == SURFACE_RAY) & before)
            free &= ((index >= 0) & through).reshape(free.shape)

        # Spread the result over all rays
        whole = np.kron(free, np.ones((FREE_RAY_STRIDE, FREE_RAY_STRIDE), dtype=bool))
        shape = image.ranges.shape
        pad = [(0, max(0, n - m)) for n, m in zip(shape, whole.shape, strict=True)]
        return np.asarray(np.pad(whole, pad, mode="edge")[: shape[0], : shape[1]])


def _fill_holes(owner: IntArray, ranges: FloatArray) -> IntArray:
    """Return ``owner`` (n_lines, n_beams) with holes filled by the nearest neighbouring owner."""
    for _ in range(FILL_ROUNDS):
        padded = np.pad(owner, 1, constant_values=-1)
        best, near = owner, np.where(owner >= 0, 0.0, np.inf)
        for i, j in NEIGHBOUR_OFFSETS:
            other = padded[1 + i : 1 + i + owner.shape[0], 1 + j : 1 + j + owner.shape[1]]
            distance = np.where(other >= 0, ranges[other], np.inf)
            best, near = np.where(distance < near, other, best), np.minimum(distance, near)
        owner = best
    return owner


def _find_near(planes: Planes, points: FloatArray, ranges: FloatArray, spacing: float) -> BoolArray:
    """Return which readings meet their plane near the point where it was seen (k,).

    Args:
        planes: The planes of the next sweep.
        points: Points at which they were seen (k, 3) [m].
        ranges: Ranges of these points (k,) [m].
        spacing: Spacing of the lines [rad].
    """
    limits = FOOTPRINT_SPACINGS * FILL_ROUNDS * spacing * ranges
    read, near = planes.ranges(planes.image), np.empty(len(points), dtype=bool)
    engine.find_near_points(*_list_rays(planes.image, planes.met), read, points, limits, near)
    return near
