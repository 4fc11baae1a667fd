"""Virtual scans: what a sweep would read of the surfaces that the latest view has seen.

The surfaces are the planes behind the noise of that view, over windows wide enough that little of
its noise is left: texture that two real scans do not share must not be found again. From a
viewpoint O2 each reading of the sweep to come meets the nearest plane that faces it (splatting with
a depth test); what hides behind them, or was never seen, stays unknown, and a ray is known to be
empty only where the latest view saw through. Each draw reads these planes anew: with range noise,
an error that neighbouring readings share, the lines' yaw jitter and the scale of all yaws, all as
strong as registration takes them to be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.planning.visibility import NextSweep, ranges_here, visible_from
from scan3d_twin.core.registration import SurfelGrid, prepare
from scan3d_twin.core.registration.compiled import compiled
from scan3d_twin.core.registration.scan_noise import BIAS_PATCH, ScanNoise
from scan3d_twin.core.registration.surfels import EMPTY, SURFACE, N, X, fit_surfels
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
"""Half sizes of the windows behind a plane, along lines and beams [rad]: up to three times those of
registration, whose normals are then 81 times as noisy in variance; upright ones for narrow faces.
"""
MOST_HALF = 20
"""Readings in half a window at most."""
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
ROUNDS = 2
"""Rounds in which empty readings take over a neighbour's plane; a nearer viewpoint needs them."""
FOOTPRINT = 1.5
"""A plane reaches this many spacings of its readings from its point."""
COARSE = 3
"""Lines and beams between the rays that are followed for seen emptiness."""
STEPS = 12
"""Places along such a ray."""
FREE_MARGIN = 0.05
"""In front of a surface by this much is free [m]."""


@dataclass(frozen=True)
class DrawnNoise:
    """The noise of the sweeps of one draw.

    Attributes:
        assumed: Standard deviations, as registration assumes them.
        yaw_scale: Relative error of all yaws of the robot.
    """

    assumed: ScanNoise
    yaw_scale: float

    def yaws(self, yaws: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the true yaws (n_lines, n_beams) [rad] behind those that odometry tells."""
        jitter = self.assumed.yaw_sigma * rng.standard_normal((len(yaws), 1))
        return np.asarray(yaws * (1.0 + self.yaw_scale) + jitter)

    def ranges(self, image: RangeImage, rng: np.random.Generator) -> FloatArray:
        """Return noisy readings (n_lines, n_beams) [m] of the ranges of ``image``."""
        sigma = self.assumed.range_sigma + self.assumed.range_sigma_per_metre * image.ranges
        noisy = image.ranges + sigma * rng.standard_normal(image.ranges.shape)
        return np.asarray(noisy + self.assumed.bias_sigma * _patches(image, rng))


def _patches(image: RangeImage, rng: np.random.Generator) -> FloatArray:
    """Return a smooth field (n_lines, n_beams) of variance 1 on average, new every ``BIAS_PATCH``.

    Linear interpolation between independent nodes has on average (2/3)^2 of their variance.
    """
    yaws, elevations = image.yaws[:, image.spec.n_beams // 2], image.spec.elevations
    line = np.abs(yaws - yaws[0]) / BIAS_PATCH
    beam = np.abs(elevations - elevations[0]) / BIAS_PATCH
    nodes = rng.standard_normal((int(line.max()) + 2, int(beam.max()) + 2))
    i, j = line.astype(np.int64), beam.astype(np.int64)
    u, v = (line - i)[:, None], beam - j
    rows = nodes[i] * (1 - u) + nodes[i + 1] * u
    return np.asarray(1.5 * (rows[:, j] * (1 - v) + rows[:, j + 1] * v))


@dataclass(frozen=True)
class Planes:
    """The plane that each reading of a sweep meets.

    Attributes:
        image: Its lines and beams; the ranges do not count.
        points: On each plane, in the frame of the image (n_lines, n_beams, 3) [m].
        normals: Unit normals (n_lines, n_beams, 3); 0 where there is no plane.
        keep: Readings that registration may use (n_lines, n_beams).
        on_target: Readings of the target (n_lines, n_beams).
        empty: Readings that are known to return nothing (n_lines, n_beams).
    """

    image: RangeImage
    points: FloatArray
    normals: FloatArray
    keep: BoolArray
    on_target: BoolArray
    empty: BoolArray

    @cached_property
    def met(self) -> BoolArray:
        """Readings that meet a plane (n_lines, n_beams)."""
        return np.asarray(np.any(self.normals != 0.0, axis=-1))

    def read(self, noise: DrawnNoise, rng: np.random.Generator) -> SurfelGrid:
        """Return the surfels of one noisy sweep.

        Raises:
            RegistrationError: Too little surface is in view.
        """
        true = replace(self.image, yaws=read_only(noise.yaws(self.image.yaws, rng)))
        ranges = noise.ranges(replace(true, ranges=read_only(self.ranges(true))), rng)
        valid = self.met & (ranges > true.spec.min_range)
        seen = replace(
            self.image,
            ranges=read_only(np.where(valid, ranges, np.nan)),
            codes=read_only(np.where(valid, VALID, 0), np.int64),
        )
        grid = prepare(seen, keep=self.keep & valid, noise=noise.assumed)
        return replace(grid, valid=valid | ~(self.met | self.empty))

    def ranges(self, image: RangeImage) -> FloatArray:
        """Return where the rays of ``image`` meet the planes (n_lines, n_beams) [m], or NaN."""
        met, (n, offset) = self.met, self._planes
        yaws, beam = image.yaws[met], np.nonzero(met)[1]
        c, s = np.cos(yaws), np.sin(yaws)
        ahead, left, up = c * n[:, 0] + s * n[:, 1], c * n[:, 1] - s * n[:, 0], n[:, 2]
        t, x, y, z = image.T_base_lidar[:3, 3], *_beams(image)[beam].T
        ranges = np.full(met.shape, np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            ranges[met] = offset - (ahead * t[0] + left * t[1] + up * t[2])
            ranges[met] /= ahead * x + left * y + up * z
        return ranges

    @cached_property
    def _planes(self) -> tuple[FloatArray, FloatArray]:
        """Normals (k, 3) of the planes that are met, and their distances from the origin (k,)."""
        normals = self.normals[self.met]
        return normals, np.asarray(np.sum(normals * self.points[self.met], axis=1))


def _beams(image: RangeImage) -> FloatArray:
    """Return the directions of the beams in ``base`` (n_beams, 3)."""
    e, R = image.spec.elevations, image.T_base_lidar[:3, :3]
    return np.asarray(np.cos(e)[:, None] * R[:, 0] + np.sin(e)[:, None] * R[:, 2])


def _eyes(image: RangeImage) -> FloatArray:
    """Return where the lidar was at each reading (n_lines, n_beams, 3) [m]."""
    lever = image.T_base_lidar[:3, 3]
    c, s = np.cos(image.yaws), np.sin(image.yaws)
    z = np.full_like(c, lever[2])
    return np.stack([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1], z], axis=-1)


@dataclass(frozen=True)
class Surface:
    """What the latest view shows of the world.

    Attributes:
        grid: Its surfels, in the scope of registration.
        on_target: Its readings of the target (n_lines, n_beams).
        half: Half the width of the sweep to come [rad].
        most: Longest range that is trusted [m].
    """

    grid: SurfelGrid
    on_target: BoolArray
    half: float
    most: float

    @property
    def here(self) -> Planes:
        """What the latest view itself would read again; made anew, as it takes 10 MB."""
        image, (rows, there) = self.grid.image, self._planes
        empty = (self.grid.known == EMPTY).reshape(there.shape)
        points, normals = np.zeros((*there.shape, 3)), np.zeros((*there.shape, 3))
        points[there], normals[there] = rows[:, X], rows[:, N]
        return Planes(image, points, normals, self._in_scope, self.on_target, empty)

    def seen_from(self, viewpoint: Pose2) -> Planes:
        """Return what the sweep at ``viewpoint``, in the frame of the latest view, would read."""
        sweep, back = self._sweep, viewpoint.inverse()
        shape = sweep.image.ranges.shape
        rows, scope, on_target = self._rows
        seen = visible_from(rows, self._ranges, viewpoint, sweep, self.most)
        points, normals = back.apply(rows[seen.index, X]), back.rotate(rows[seen.index, N])
        owner = np.full(sweep.image.ranges.size, -1)
        far_first = np.argsort(-seen.ranges)
        owner[sweep.cells(points)[0][far_first]] = far_first
        owner = _spread(owner.reshape(shape), seen.ranges)
        found = owner >= 0
        planes = Planes(
            sweep.image,
            points[owner],
            np.where(found[..., None], normals[owner], 0.0),
            found & scope[seen.index][owner],
            found & on_target[seen.index][owner],
            np.zeros(shape, dtype=bool),
        )
        planes = _trimmed(planes, seen.ranges[owner], self.grid.line_spacing)
        return replace(planes, empty=~planes.met & self._seen_through(viewpoint))

    @cached_property
    def _planes(self) -> tuple[FloatArray, BoolArray]:
        """Planes behind the readings (n, 8), whatever their scope, and which readings have one."""
        image, noise = self.grid.image, self.grid.noise
        elevations = image.spec.elevations
        steps = np.array([self.grid.line_spacing, float(np.median(np.abs(np.diff(elevations))))])
        halves = np.clip(np.round(np.array(WINDOWS) / steps), 1, MOST_HALF)
        valid, run = self.grid.valid, compiled("fit_surfels") or fit_surfels
        rows, index = run(
            np.array(image.ranges), np.array(image.yaws), _beams(image),
            np.array(image.T_base_lidar[:3, 3]), valid, valid,
            np.array([noise.range_sigma, noise.range_sigma_per_metre]), halves.astype(np.int64),
        )  # fmt: skip
        return rows, np.asarray(index >= 0)

    @cached_property
    def _in_scope(self) -> BoolArray:
        return np.asarray((self.grid.known == SURFACE).reshape(self.grid.valid.shape))

    @cached_property
    def _rows(self) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Return the planes as rows (n, 8), and which are in scope and of the target (n,)."""
        rows, there = self._planes
        return rows, self._in_scope[there], self.on_target[there]

    @cached_property
    def _ranges(self) -> FloatArray:
        return ranges_here(self._rows[0], self.grid)

    @cached_property
    def _sweep(self) -> NextSweep:
        return NextSweep.like(self.grid, self.half)

    def _seen_through(self, viewpoint: Pose2) -> BoolArray:
        """Tell which rays from ``viewpoint`` the latest view saw to be free all along."""
        image, grid = self._sweep.image, self.grid
        at = np.s_[COARSE // 2 :: COARSE, COARSE // 2 :: COARSE]
        eyes, rays = _eyes(image)[at], image.directions[at]
        free = np.ones(rays.shape[:2], dtype=bool)
        known, row_of = grid.known, grid.index.reshape(-1)
        for way in np.linspace(0.5, self.most, STEPS):
            places = viewpoint.apply((eyes + way * rays).reshape(-1, 3))
            index = grid.projection.lookup(places, known)
            rows = grid.rows[row_of[index]]
            before = np.sum(rows[:, N] * (places - rows[:, X]), axis=1) > FREE_MARGIN
            through = (known[index] == EMPTY) | ((known[index] == SURFACE) & before)
            free &= ((index >= 0) & through).reshape(free.shape)
        whole = np.kron(free, np.ones((COARSE, COARSE), dtype=bool))
        shape = image.ranges.shape
        pad = [(0, max(0, n - m)) for n, m in zip(shape, whole.shape, strict=True)]
        return np.asarray(np.pad(whole, pad, mode="edge")[: shape[0], : shape[1]])


def _spread(owner: IntArray, ranges: FloatArray) -> IntArray:
    """Return ``owner`` (n_lines, n_beams) with holes given to the nearest owner beside them."""
    for _ in range(ROUNDS):
        padded = np.pad(owner, 1, constant_values=-1)
        best, near = owner, np.where(owner >= 0, 0.0, np.inf)
        for i, j in NEIGHBOURS:
            other = padded[1 + i : 1 + i + owner.shape[0], 1 + j : 1 + j + owner.shape[1]]
            distance = np.where(other >= 0, ranges[other], np.inf)
            best, near = np.where(distance < near, other, best), np.minimum(distance, near)
        owner = best
    return owner


def _trimmed(planes: Planes, ranges: FloatArray, spacing: float) -> Planes:
    """Return ``planes`` without readings that meet theirs far from where it was seen.

    Args:
        planes: Of the sweep to come.
        ranges: Of the point of each reading's plane (n_lines, n_beams) [m].
        spacing: Of the lines [rad].
    """
    met, rays = planes.ranges(planes.image), planes.image.directions
    off = _eyes(planes.image) + met[..., None] * rays - planes.points
    across = off - np.sum(off * rays, axis=-1, keepdims=True) * rays
    with np.errstate(invalid="ignore"):
        near = np.sqrt(np.sum(across**2, axis=-1)) < FOOTPRINT * ROUNDS * spacing * ranges
        near &= met > 0
    return replace(
        planes,
        normals=np.where(near[..., None], planes.normals, 0.0),
        keep=planes.keep & near,
        on_target=planes.on_target & near,
    )
