"""Target extraction (paper section 4.2): the salient target without floor, background and strays.

The paper applies "edge detection" to remove the background. Here a range image is cut at its depth
edges, and the pieces are grouped by their distance in the top view. A thing that stands free shows
farther background on both its sides; the background itself does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.grids import dilate, label_components
from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.readings import SweepPoints
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    RangeImage,
    Scan3D,
    read_only,
)

CELL = 0.05
"""Cell of the top view in which points are grouped [m]; a quarter of the default cluster_gap."""
DEPTH_EDGE = 0.10
"""Neighbouring readings that differ by more are on different surfaces [m]; a plane seen at 80 deg
incidence from 1.5 m changes by 0.08 m within a line spacing of 0.5 deg."""
GRAZING = math.radians(75.0)
"""Up to this incidence a step in depth between two lines may still be one and the same wall."""
COMPACT = 3.5
"""A salient target is smaller than this [m]; larger things are taken if there is nothing else."""


def all_points(image: RangeImage, config: Config) -> Scan3D:
    """Return every trusted point of the sweep except the floor and the robot itself."""
    with np.errstate(invalid="ignore"):
        keep = image.ranges <= config.target.max_range
        keep &= image.heights > config.target.floor_height
    points, lines, beams, distance = SweepPoints.of(image, keep)
    sweep = Scan3D(points, lines, beams, image.n_lines)
    outside = distance > config.motion.self_radius
    return sweep if outside.all() else sweep.select(outside)


def extract_target(
    image: RangeImage, sweep: Scan3D, known: FloatArray, config: TargetConfig
) -> Scan3D:
    """Return the points of ``sweep`` that belong to the target.

    Args:
        image: The sweep's range image, gaps filled.
        sweep: Its points as ``all_points`` returns them.
        known: Top view (n, 2) of what is known of the target, in ``scan`` [m].
        config: Window and thresholds.

    Returns:
        The points in the window that lie in a top-view group touching ``known``; pieces of the
        range image with fewer than ``config.min_points`` points are stray points and left out.
    """
    windowed = sweep.select(in_window(image, sweep.beams, config))
    windowed = windowed.select(_piece_sizes(image, windowed) >= config.min_points)
    if len(windowed) == 0:
        return windowed
    groups = _group_top_view(windowed.points[:, :2], config.cluster_gap)
    touching = _touching(windowed.points[:, :2], groups, known, config.cluster_gap)
    return windowed.select(touching[groups])


def in_window(image: RangeImage, beams: IntArray, config: TargetConfig) -> BoolArray:
    """Tell which ``beams`` lie in the vertical window that is modelled."""
    return np.asarray(np.abs(image.spec.elevations[beams]) <= config.window / 2)


@dataclass(frozen=True)
class _Group:
    """A candidate target of the look around: its top view and how much it stands out."""

    points: FloatArray
    salience: float
    stands_free: bool
    compact: bool

    @property
    def rank(self) -> int:
        """2 for a compact thing that stands free, 1 for a large one, 0 for background."""
        return self.stands_free * (1 + self.compact)


def find_target(look: Observation, near: tuple[float, float] | None, config: Config) -> FloatArray:
    """Return the top view (n, 2) in ``odom`` [m] of the salient target of a look around.

    Args:
        look: A sweep of one full turn.
        near: Place (x, y) in ``odom`` of the wanted target, or None to choose the most salient:
            of the things that stand free of the background, preferably one smaller than
            ``COMPACT``, the one with the largest face towards the robot, ahead rather than behind.
        config: Thresholds.

    Raises:
        SceneError: Nothing was seen, or nothing near ``near``.
    """
    groups = _groups(look, config)
    if near is not None:
        return _nearest(groups, look, near)
    best = max(groups, key=lambda group: (group.rank, group.salience))
    return look.T_odom_scan.apply(best.points)


def find_targets(look: Observation, count: int, config: Config) -> list[FloatArray]:
    """Return the top views (n, 2) in ``odom`` [m] of the most salient things, at most ``count``.

    Only things that stand free are taken for targets, except for the first; see ``find_target``.

    Raises:
        SceneError: Nothing was seen.
    """
    groups = sorted(_groups(look, config), key=lambda g: (g.rank, g.salience), reverse=True)
    free = [group for group in groups if group.rank > 0]
    return [look.T_odom_scan.apply(group.points) for group in (free or groups[:1])[:count]]


def _groups(look: Observation, config: Config) -> list[_Group]:
    """Return the things that a look around shows, at least one."""
    sweep = all_points(look.image, config)
    sweep = sweep.select(in_window(look.image, sweep.beams, config.target))
    if len(sweep) < config.target.min_points:
        raise SceneError(
            f"no target: the look around saw nothing within {config.target.max_range:g} m; "
            "start the robot nearer to the target"
        )
    distance = float(np.median(np.linalg.norm(sweep.points[:, :2], axis=1)))
    gap = config.target.cluster_gap + distance * _line_spacing(look.image)
    labels = _group_top_view(sweep.points[:, :2], gap)
    groups = [
        _judge(look.image, sweep, labels == label)
        for label in np.unique(labels)
        if np.count_nonzero(labels == label) >= config.target.min_points
    ]
    if not groups:
        raise SceneError("no target: the look around saw only stray points")
    return groups


def _nearest(groups: list[_Group], look: Observation, near: tuple[float, float]) -> FloatArray:
    """Return the group that comes nearest to ``near`` in ``odom``, if within half a metre."""
    limit = 0.5
    views = [look.T_odom_scan.apply(group.points) for group in groups]
    distances = [float(np.min(np.linalg.norm(view - near, axis=1))) for view in views]
    if not distances or min(distances) > limit:
        raise SceneError(
            f"no target within {limit} m of ({near[0]:.2f}, {near[1]:.2f}); the place is meant in "
            "metres from where the robot starts, x ahead and y to the left"
        )
    return views[int(np.argmin(distances))]


def _judge(image: RangeImage, sweep: Scan3D, member: BoolArray) -> _Group:
    """Tell how a group stands out: is what is seen on either side of it farther away?"""
    foremost = _nearest_per_line(sweep.points, sweep.lines, image.n_lines)
    own = _nearest_per_line(sweep.points[member], sweep.lines[member], image.n_lines)
    lines = np.flatnonzero(np.isfinite(own))
    gaps = np.diff(np.append(lines, lines[0] + image.n_lines))
    widest = int(np.argmax(gaps))
    stands_free = False
    if gaps[widest] > 1:
        right, left = lines[widest], lines[(widest + 1) % len(lines)]
        beyond = foremost[[(right + 1) % image.n_lines, left - 1]]
        stands_free = bool(np.all(beyond > own[[right, left]] * (1 + _grazing_step(image))))
    points = sweep.points[member, :2]
    extent = float(np.max(np.ptp(points, axis=0)))
    return _Group(points, _salience(image, sweep.points[member]), stands_free, extent <= COMPACT)


def _salience(image: RangeImage, points: FloatArray) -> float:
    """Return the area [m2] that ``points`` (n, 3) show to the robot, weighted by where they are.

    The area and not the share of the view: a twig close by is no more salient than a box behind it.
    The weight falls from 1 ahead to 0 behind, since people put a robot so that it faces its target.
    """
    beams = float(np.median(np.abs(np.diff(image.spec.elevations))))
    area = float(np.sum(points[:, :2] ** 2)) * _line_spacing(image) * beams
    x, y = points[:, :2].mean(axis=0)
    ahead = (1.0 + float(x) / max(math.hypot(float(x), float(y)), 1e-9)) / 2
    return area * ahead


def _grazing_step(image: RangeImage) -> float:
    """Return by how much, relatively, a wall seen at ``GRAZING`` recedes from line to line."""
    return math.tan(GRAZING) * _line_spacing(image)


def _line_spacing(image: RangeImage) -> float:
    """Return the typical angle between two lines [rad]."""
    return float(np.median(-np.diff(image.yaws[:, image.spec.n_beams // 2])))


def _nearest_per_line(points: FloatArray, lines: IntArray, n_lines: int) -> FloatArray:
    """Return the smallest horizontal distance in each line (n_lines,) [m]; inf for no point."""
    distances = np.full(n_lines, math.inf)
    np.minimum.at(distances, lines, np.hypot(points[:, 0], points[:, 1]))
    return distances


def _group_top_view(points: FloatArray, gap: float) -> IntArray:
    """Label ``points`` (n, 2) so that things closer than about ``gap`` [m] share a label (n,)."""
    columns = np.ascontiguousarray(points.T)
    cells = np.floor((columns - columns.min(axis=1, keepdims=True)) / CELL).astype(np.int64)
    margin = math.ceil(gap / CELL / 2)
    i, j = cells + margin
    grid = np.zeros((i.max() + 1 + margin, j.max() + 1 + margin), dtype=bool)
    grid[i, j] = True
    labels = label_components(dilate(grid, (gap / CELL - 1) / 2))
    return np.asarray(labels[i, j], dtype=np.int64)


def _touching(points: FloatArray, groups: IntArray, known: FloatArray, gap: float) -> BoolArray:
    """Tell which groups (k,) of ``points`` (n, 2) come within ``gap`` [m] of ``known`` (m, 2).

    Two points whose cells are so near that no two of theirs can be farther apart are near; for most
    groups that settles it. Distances are worked out for the others alone, where they can be small.
    """
    columns, (x, y) = np.ascontiguousarray(points.T), np.ascontiguousarray(known.T)
    low = columns.min(axis=1) - gap - 2 * CELL
    size = np.floor((columns.max(axis=1) + gap + 2 * CELL - low) / CELL).astype(np.int64) + 1
    i = np.floor((x - low[0]) / CELL).astype(np.int64)
    j = np.floor((y - low[1]) / CELL).astype(np.int64)
    inside = (i >= 0) & (i < size[0]) & (j >= 0) & (j < size[1])
    grid = np.zeros(size, dtype=bool)
    grid[i[inside], j[inside]] = True
    row, column = np.floor((columns - low[:, None]) / CELL).astype(np.int64)
    cell = row * size[1] + column
    diagonal = math.sqrt(2.0) * CELL
    near = dilate(grid, gap - 1.01 * diagonal, CELL).take(cell)
    touching = np.bincount(groups[near], minlength=int(groups.max()) + 1) > 0
    possible = dilate(grid, gap + 1.01 * diagonal, CELL).take(cell) & ~touching[groups]
    if possible.any():
        distance, _ = nearest(cKDTree(known), points[possible])
        touching[groups[possible][distance <= gap]] = True
    return touching


def _piece_sizes(image: RangeImage, scan: Scan3D) -> IntArray:
    """Return for each point the size (n,) of its piece of the range image, cut at depth edges.

    ``native/grids.h`` finds them.
    """
    sizes = np.empty(len(scan), dtype=np.int64)
    lines, beams = np.ascontiguousarray(scan.lines), np.ascontiguousarray(scan.beams)
    ranges = read_only(image.ranges)
    if (
        engine.measure_components(ranges, *ranges.shape, lines, beams, len(scan), DEPTH_EDGE, sizes)
        < 0
    ):
        raise MemoryError
    return sizes
