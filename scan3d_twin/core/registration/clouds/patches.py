"""Surface patches of an unorganised point cloud at several resolutions.

Points are sorted into cubic cells, whose moments (number, sum, sum of products) are added up once;
every coarser level merges eight cells into one, as in multi-resolution surfel maps (Stueckler and
Behnke, JVCIR 2014). The patch of a cell is the plane through all points within two sides of its
centroid: centroid, normal n of least variance (Hoppe et al., SIGGRAPH 1992) and the variances
l1 <= l2 <= l3, of which l1 is the variance of one point along n: noise, roughness and curvature.

A patch is flat where l2 is several times l1. Below that noise decides on the normal, which happens
where the noise is as large as the patch, on the single rings of a spinning lidar, on thin things
and across edges; there the next coarser level is taken. Sides are powers of two [mm], so that two
clouds have levels in common; the finest is chosen by the number of cells and not by any known
noise or spacing. ``native/cells.h`` computes all of this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.panorama import Panorama
from scan3d_twin.core.registration.pose_prior import Moments
from scan3d_twin.core.types import BoolArray, FloatArray, SmallIntArray

MIN_POINTS = 50
"""Least number of finite points in a cloud."""
MIN_INCIDENCE = 0.1
"""Least cosine of incidence of a patch: where a ring of a spinning lidar runs round a corner, the
flattest plane is that of the ring, which contains the viewpoint and moves along with it."""
MIN_VARIANCE_SHARE = 0.5
"""Least l1 of a patch, in the median of its level: across such a ring there is no noise."""
MIN_FLAT_SHARE = 0.15
"""Least share of flat patches of the finest level: one with fewer shows noise."""
MAX_CELLS = 6000
"""Most cells of the finest level: bounds the time; all points count through their moments."""
MIN_POINTS_PER_CELL = 2.8
"""Least mean number of points in a cell of the finest level, so that a window of the first radius,
some 7 cells on a surface, holds 20 points: with fewer the errors of normals decide."""
MAX_CELL_NUMBER = 2.0**30
"""Largest index of a cell along an axis: they are 32-bit integers."""
MAX_LEVELS = 20
"""Most halvings of the extent of a cloud, whose points may coincide."""
MIN_CELLS = 60
"""A level with fewer cells is the coarsest."""
WINDOW_RADII = (1.5, 2.2)
"""Radii of the window of a patch, in sides of its cell: the second where the first is not flat."""
MIN_WINDOW_POINTS = 10.0
"""Least number of points of a flat patch."""
MIN_FLATNESS = 3.0
"""Least l2 / l1 of a flat patch: noise turns its normal by at most some 1 / sqrt(n (l2 / l1))."""
MIN_WIDTH = 1 / 30
"""Least l2 / l3 of a flat patch: narrower ones are lines."""

SAMPLE_SIZE = 800
"""Most patches of the source in a coarse step."""

MOMENTS, PATCH = 10, 10
"""Numbers of the moments of a cell, and of a patch, in the order of ``native/cells.h``."""
POINT, NORMAL = slice(0, 3), slice(3, 6)
LEAST, WINDOW = 6, 9


@dataclass(frozen=True)
class Level:
    """The patches of a cloud at one resolution.

    Attributes:
        exponent: The side of a cell is 2^exponent mm.
        patches: Patch of each cell (m, PATCH): centroid of its window, unit normal towards the
            viewpoint, variances l1 l2 l3 [m2] and number of points.
        counts: Number of points in each cell (m,).
        flat: Whether each patch is flat (m,).
        parents: Cell of the next coarser level that each lies in (m,); None on the coarsest.
    """

    exponent: int
    patches: FloatArray
    counts: FloatArray
    flat: BoolArray
    parents: SmallIntArray | None

    @property
    def side(self) -> float:
        """Side of a cell [m]."""
        return math.ldexp(1e-3, self.exponent)

    @cached_property
    def flat_patches(self) -> FloatArray:
        """The flat patches (k, PATCH)."""
        return np.ascontiguousarray(self.patches[self.flat])

    @cached_property
    def sample(self) -> FloatArray:
        """At most ``SAMPLE_SIZE`` of the flat patches, for the coarse steps."""
        stride = math.ceil(len(self.flat_patches) / SAMPLE_SIZE)
        return np.ascontiguousarray(self.flat_patches[:: max(1, stride)])

    @cached_property
    def tree(self) -> Tree:
        """k-d tree of their centroids."""
        return Tree.of(np.ascontiguousarray(self.flat_patches[:, POINT]))

    @cached_property
    def own_share(self) -> float:
        """Points of the cells per point of the windows: a point takes part in 1 / this windows."""
        within = float(self.flat_patches[:, WINDOW].sum())
        return float(self.counts[self.flat].sum()) / within if within > 0 else 1.0


@dataclass(frozen=True)
class Cloud:
    """A point cloud with its surface patches.

    Attributes:
        points: Finite points (n, 3) [m].
        levels: Patches from the finest to the coarsest level.
        moments: Moments of the points.
    """

    points: FloatArray
    levels: tuple[Level, ...]
    moments: Moments

    @property
    def finest(self) -> int:
        """Exponent of the finest level."""
        return self.levels[0].exponent

    @property
    def coarsest(self) -> int:
        """Exponent of the coarsest level."""
        return self.levels[-1].exponent

    def level(self, exponent: int) -> Level:
        """Return the level whose cells have a side of 2^exponent mm."""
        return self.levels[exponent - self.finest]

    @cached_property
    def radius(self) -> float:
        """RMS distance of the points from their mean [m]."""
        first, second = self.moments
        return math.sqrt(max(0.0, float(np.trace(second) - first @ first)))

    @cached_property
    def panorama(self) -> Panorama:
        """Free space around the viewpoint."""
        return Panorama.of(self.points)

    def choose_cells(self, finest: int) -> list[tuple[Level, SmallIntArray, FloatArray]]:
        """Return for each level the cells at whose resolution the cloud is registered.

        A cell is used where its patch is flat and no finer one is: every point counts once.

        Args:
            finest: Exponent of the finest level to use.

        Returns:
            Each level with the indices of the cells used (k,) and the share of the points in each
            that no finer level has used, 0..1 (k,).
        """
        chosen, left = [], self.level(finest).counts
        for level in self.levels[finest - self.finest :]:
            used = level.flat & (left >= 0.5 * level.counts)
            at = np.flatnonzero(used).astype(np.int32)
            chosen.append((level, at, left[at] / level.counts[at]))
            if level.parents is not None:
                rest = np.where(used, 0.0, left)
                left = np.bincount(level.parents, rest).astype(np.float64)
        return chosen


def prepare_cloud(points: FloatArray) -> Cloud:
    """Fit patches to a cloud (n, 3) [m] seen from its origin; NaN rows are left out.

    Raises:
        ConfigError: The array has another shape.
        RegistrationError: The cloud has too few finite points.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ConfigError(f"a cloud has shape (n, 3), got {points.shape}")
    finite = np.isfinite(points)
    points = np.ascontiguousarray(points if finite.all() else points[finite.all(axis=1)])
    if len(points) < MIN_POINTS:
        raise RegistrationError(
            f"the cloud has {len(points)} finite points, {MIN_POINTS} are needed"
        )

    # Sum up the moments of the finest cells.
    columns = np.ascontiguousarray(points.T)  # NumPy reduces these 20 times as fast
    mean = columns.mean(axis=1)
    exponent, cells, numbers = _find_finest(points, columns)
    moments = np.zeros((len(cells), MOMENTS))
    engine.sum_moments(points, mean, numbers, len(points), moments)

    # Merge cells, level by level; a finest level that shows nothing but noise is left out.
    levels: list[Level] = []
    while True:
        patches, flat = _fit_patches(moments, mean, math.ldexp(1e-3, exponent))
        last = len(cells) <= MIN_CELLS
        if last or levels or np.count_nonzero(flat) >= MIN_FLAT_SHARE * len(flat):
            levels.append(Level(exponent, patches, moments[:, 0].copy(), flat, None))
        if last:
            return Cloud(points, tuple(levels), _sum_up(moments, mean))
        cells, numbers = _number_cells(cells >> 1)
        if levels:
            levels[-1] = replace(levels[-1], parents=numbers)
        exponent, moments = exponent + 1, _add_moments(moments, numbers, len(cells))


def _sum_up(moments: FloatArray, mean: FloatArray) -> Moments:
    """Return the moments of all points, given those of their cells (m, MOMENTS) about ``mean``."""
    n, *_, xx, xy, xz, yy, yz, zz = moments.sum(axis=0)
    second = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) / n
    return Moments(mean, second + np.outer(mean, mean))


def _find_finest(
    points: FloatArray, columns: FloatArray
) -> tuple[int, SmallIntArray, SmallIntArray]:
    """Return the exponent of the finest level, its cells (m, 3) and the cell of each point (n,).

    Args:
        points: The points (n, 3) [m].
        columns: The same by coordinates (3, n).
    """
    most = max(MIN_CELLS, min(MAX_CELLS, len(points) / MIN_POINTS_PER_CELL))
    low, high = columns.min(axis=1), columns.max(axis=1)
    extent = max(float((high - low).max()), 1e-6)
    farthest = max(float(-low.min()), float(high.max()), 1e-6)
    least = math.ceil(math.log2(1e3 * farthest / MAX_CELL_NUMBER))
    exponent = max(math.ceil(math.log2(1e3 * extent / 64)), least)
    found = _sort_into_cells(points, exponent)
    while len(found[0]) > most:
        exponent += 1
        found = _sort_into_cells(points, exponent)
    while exponent > least and exponent > math.log2(1e3 * extent) - MAX_LEVELS:
        finer = _sort_into_cells(points, exponent - 1)
        if len(finer[0]) > most:
            break
        exponent, found = exponent - 1, finer
    return exponent, *found


def _sort_into_cells(points: FloatArray, exponent: int) -> tuple[SmallIntArray, SmallIntArray]:
    cells = np.empty(points.shape, np.int32)
    engine.find_cells(points, len(points), math.ldexp(1e3, -exponent), cells)
    return _number_cells(cells)


def _number_cells(cells: SmallIntArray) -> tuple[SmallIntArray, SmallIntArray]:
    """Return the distinct ones of ``cells`` (n, 3) and the number of each (n,)."""
    distinct, numbers = np.empty_like(cells), np.empty(len(cells), np.int32)
    m = engine.number_cells(cells, len(cells), distinct, numbers)
    if m < 0:
        raise MemoryError
    return distinct[:m], numbers


def _add_moments(moments: FloatArray, numbers: SmallIntArray, m: int) -> FloatArray:
    sums = np.zeros((m, MOMENTS))
    engine.add_moments(moments, numbers, len(numbers), sums)
    return sums


def _fit_patches(
    moments: FloatArray, mean: FloatArray, side: float
) -> tuple[FloatArray, BoolArray]:
    """Return the patch of each cell (m, PATCH), and whether it is flat (m,).

    Args:
        moments: Moments of each cell (m, MOMENTS), about the mean of the cloud.
        mean: Mean of the cloud (3,) [m], seen from the viewpoint.
        side: Side of a cell [m].
    """
    m, radii = len(moments), np.array(WINDOW_RADII) * side
    patches, flat = np.empty((m, PATCH)), np.empty(m, dtype=bool)
    tree = Tree.of(np.ascontiguousarray(moments[:, 1:4] / moments[:, :1]))
    if engine.fit_patches(
        tree.points, tree.order, tree.axes, m, moments, radii, len(radii),
        MIN_WINDOW_POINTS, MIN_FLATNESS, MIN_WIDTH, patches, flat,
    ) < 0:  # fmt: skip
        raise MemoryError

    # Face the viewpoint.
    patches[:, POINT] += mean
    towards = -np.einsum("ij,ij->i", patches[:, NORMAL], patches[:, POINT])
    patches[towards < 0, NORMAL] *= -1.0

    # Trust no grazing patch much more than the usual one.
    ranges = np.sqrt(np.einsum("ij,ij->i", patches[:, POINT], patches[:, POINT]))
    grazing = np.abs(towards) < MIN_INCIDENCE * ranges
    if flat.any():
        variances = patches[flat, LEAST]
        least = MIN_VARIANCE_SHARE * float(engine.find_median(variances, len(variances)))
        patches[grazing, LEAST] = np.maximum(patches[grazing, LEAST], least)
    return patches, flat
