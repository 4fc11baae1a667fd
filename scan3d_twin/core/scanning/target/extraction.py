"""Target extraction (paper section 4.2): the points of the target without floor, walls and strays.

The paper removes the background by "edge detection". Here a range image is cut at its depth edges,
and the pieces are grouped by their distance in the top view. ``selection.py`` chooses the
target in a panorama; in a sweep it is what touches the points that are known of it.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.grids import dilate, label_cells
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.sweep_points import SweepPoints
from scan3d_twin.core.scanning.target.walls import (
    Wall,
    find_walls,
    is_on_walls,
    reaches_wall_height,
)
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, RangeImage, Scan3D, read_only

FLOOR_DISTANCE = 2.0
"""Range from which the floor may seem as high as ``floor_height`` [m]: 0.5 deg of the mount are 17
mm there. In the typical world 0.01 % of its readings at 0.3 to 1.2 m are above 15 mm."""
GROUPING_CELL = 0.05
"""Side of a cell of the top view in which points are grouped [m]; a quarter of the default
cluster_gap."""
DEPTH_EDGE = 0.10
"""Difference of neighbouring readings above which they are on different surfaces [m]; a plane seen
at 80 deg incidence from 1.5 m recedes by 0.08 m within a line spacing of 0.5 deg."""
MAX_SHARED = 0.2
"""Largest share of the target's known points on a wall or behind it (assumption)."""
WALL_REGISTRATION = 0.06
"""Distance from a wall within which known points of the target are on it [m]: its own noise and the
error of odometry after a move."""
MIN_KEPT = 0.3
"""Least part of the target's known places that must still show something once the walls are taken
away (assumption); else the wall is the target, which odometry has put beside itself: by 0.2 m after
a move of 2.5 m and a turn of 130 deg in the typical world. Of a thing at a wall up to half of the
places are so near to it that the wall shows them, too."""
MAX_PLACES = 2000
"""About how many known points of the target are looked at for that."""


def extract_points(image: RangeImage, config: Config) -> Scan3D:
    """Return all points of ``image`` within range, except the floor and the robot itself.

    Half of ``floor_height`` is enough at 0.6 to 1 m: the floor is seen at a flat angle there, at
    which the noise of its readings hardly shows in their height, and errors of the mount grow with
    the distance. Of a thing of 0.1 m, its lowest 3 cm are a third.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        keep = image.ranges_within(config.target.max_range)
        share = np.maximum(image.ranges / FLOOR_DISTANCE, LIDAR_HEIGHT / image.ranges)
        share = np.clip(share, 0.5, 1.0)
        keep &= image.heights > config.target.floor_height * share
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
        sweep: Its points as ``extract_points`` returns them.
        known: Top view (n, 2) of the known points of the target, in ``scan`` [m].
        config: Window and thresholds.

    Returns:
        The points in the window whose top-view group touches ``known``, without stray points,
        pieces of the range image with fewer than ``config.min_points`` points, and without the
        walls behind the target.
    """
    # Take all that touches what is known
    windowed = sweep.select(is_in_window(image, sweep.lines, sweep.beams, config))
    target = _select_touching(image, windowed, known, config)

    # Without walls, if it may contain some
    slope = math.tan(config.window / 2)
    if not reaches_wall_height(target.points, config.max_range, slope).any():
        return target
    walls = _find_background_walls(sweep.points, known, config)
    if not walls:
        return target
    off_walls = windowed.select(~is_on_walls(windowed.points[:, :2], walls))
    rest = _select_touching(image, off_walls, known, config)

    # Unless they are the target
    places = known[:: max(1, len(known) // MAX_PLACES)]
    shown, left = (_share_shown(places, scan, config.cluster_gap) for scan in (target, rest))
    return target if left < MIN_KEPT * shown else rest


def _select_touching(
    image: RangeImage, windowed: Scan3D, known: FloatArray, config: TargetConfig
) -> Scan3D:
    """Return the points of ``windowed`` whose top-view group touches ``known``, without strays."""
    windowed = windowed.select(measure_pieces(image, windowed) >= config.min_points)
    if len(windowed) == 0:
        return windowed
    groups = group_top_view(windowed.points[:, :2], config.cluster_gap)
    touching = _find_touching(windowed.points[:, :2], groups, known, config.cluster_gap)
    return windowed.select(touching[groups])


def _share_shown(places: FloatArray, scan: Scan3D, gap: float) -> float:
    """Return the share of ``places`` (n, 2) that have a point of ``scan`` within ``gap`` [m]."""
    if len(scan) == 0:
        return 0.0
    return float(np.mean(Tree.of(scan.points[:, :2]).is_near(places, gap)))


def _find_background_walls(
    points: FloatArray, known: FloatArray, config: TargetConfig
) -> list[Wall]:
    """Return the walls among ``points`` (n, 3) behind the ``known`` top view (m, 2) of the target.

    A wall of which the target shows more than ``MAX_SHARED`` is the target itself, and so is a
    plane with a part of the target behind it, such as a high side of a convex thing.
    """
    return [
        wall
        for wall in find_walls(points, config.max_range)
        if np.mean(wall.contains(known, WALL_REGISTRATION)) <= MAX_SHARED
        and np.mean(wall.distance(known) < -WALL_REGISTRATION) <= MAX_SHARED
    ]


def is_in_window(
    image: RangeImage, lines: IntArray, beams: IntArray, config: TargetConfig
) -> BoolArray:
    """Return which readings, by ``lines`` and ``beams`` (n,), are in the modelled window (n,)."""
    return np.asarray(np.abs(image.elevations_at(lines, beams)) <= config.window / 2)


def group_top_view(points: FloatArray, gap: float) -> IntArray:
    """Label ``points`` (n, 2) so that things closer than about ``gap`` [m] share a label (n,)."""
    columns = np.ascontiguousarray(points.T)
    cells = np.floor((columns - columns.min(axis=1, keepdims=True)) / GROUPING_CELL).astype(
        np.int64
    )
    margin = math.ceil(gap / GROUPING_CELL / 2)
    i, j = cells + margin
    grid = np.zeros((i.max() + 1 + margin, j.max() + 1 + margin), dtype=bool)
    grid[i, j] = True
    labels = label_cells(dilate(grid, (gap / GROUPING_CELL - 1) / 2))
    return np.asarray(labels[i, j], dtype=np.int64)


def _find_touching(
    points: FloatArray, groups: IntArray, known: FloatArray, gap: float
) -> BoolArray:
    """Return which groups (k,) of ``points`` (n, 2) come within ``gap`` [m] of ``known`` (m, 2).

    For most groups the cells of the points decide: two points are surely near if the farthest
    points of their cells are. Distances are computed only for the groups that remain undecided.
    """
    columns, (x, y) = np.ascontiguousarray(points.T), np.ascontiguousarray(known.T)
    low = columns.min(axis=1) - gap - 2 * GROUPING_CELL
    size = (
        np.floor((columns.max(axis=1) + gap + 2 * GROUPING_CELL - low) / GROUPING_CELL).astype(
            np.int64
        )
        + 1
    )
    i = np.floor((x - low[0]) / GROUPING_CELL).astype(np.int64)
    j = np.floor((y - low[1]) / GROUPING_CELL).astype(np.int64)
    inside = (i >= 0) & (i < size[0]) & (j >= 0) & (j < size[1])
    grid = np.zeros(size, dtype=bool)
    grid[i[inside], j[inside]] = True
    row, column = np.floor((columns - low[:, None]) / GROUPING_CELL).astype(np.int64)
    cell = row * size[1] + column
    diagonal = math.sqrt(2.0) * GROUPING_CELL
    near = dilate(grid, gap - 1.01 * diagonal, GROUPING_CELL).take(cell)
    touching = np.bincount(groups[near], minlength=int(groups.max()) + 1) > 0
    possible = dilate(grid, gap + 1.01 * diagonal, GROUPING_CELL).take(cell) & ~touching[groups]
    if possible.any():
        near_known = Tree.of(known).is_near(points[possible], gap)
        touching[groups[possible][near_known]] = True
    return touching


def measure_pieces(image: RangeImage, scan: Scan3D) -> IntArray:
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
