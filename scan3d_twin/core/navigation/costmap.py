"""Costmap of the floor from the robot's own scans: inflation, reachable poses, shortest paths.

A cell is free only when the floor was seen up to it and nothing stands between; unknown space is
lethal. The robot is a disc: obstacles are inflated by its radius and clearance, and a search for
paths in the plane is complete.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.grids import (
    erode,
    find_connected,
    find_shortest_paths,
)
from scan3d_twin.core.registration.native import ByteArray, engine
from scan3d_twin.core.registration.surfels.sweep_points import SweepPoints
from scan3d_twin.core.session import Workspace
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    Pose2,
    RangeImage,
)

RESOLUTION = 0.05
"""Side of a cell [m]; about a third of the robot's radius."""
FLOOR_STEP = 0.45
"""Distance of two floor hits along a line above which the floor between them is unknown [m]; at 4 m
from a lidar 0.30 m high, beams 0.35 deg apart hit the floor 0.33 m apart."""
HEIGHT_MARGIN = 0.05
"""Height above the robot's top up to which things are obstacles [m]."""

FLOOR, SOLID = 1, 2
"""What a reading that looks ahead can be of."""

UNKNOWN, FREE, OBSTACLE, TOUCHED = 0, 1, 2, 3
"""Values of a cell. Touched cells keep their value, as the lidar does not see what is there."""


@dataclass(frozen=True)
class Costmap:
    """A grid of what is known of the floor, in frame ``odom``.

    Attributes:
        origin: Corner of cell (0, 0) (2,) [m].
        cells: ``UNKNOWN``, ``FREE``, ``OBSTACLE`` or ``TOUCHED`` (nx, ny).
        inflation_radius: Distance that the robot's centre keeps from all that is not free [m].
        start: Where the robot stands (2,); it fits there, whatever the cells around it are.
    """

    origin: FloatArray
    cells: IntArray
    inflation_radius: float
    start: FloatArray

    @cached_property
    def passable(self) -> BoolArray:
        """Cells in which the robot's centre may be (nx, ny): the free ones after inflation."""
        free = self.cells == FREE
        free |= self._disc(self.start, self.inflation_radius + RESOLUTION)
        return erode(free, self.inflation_radius, RESOLUTION) | self._disc(self.start, RESOLUTION)

    @cached_property
    def reachable(self) -> BoolArray:
        """Cells that the robot's centre can reach (nx, ny)."""
        return find_connected(self.passable, self._cell_of(*self.start))

    @cached_property
    def _search(self) -> tuple[FloatArray, IntArray]:
        """Length of the path from the start to every cell [m], the cell before it (nx * ny,)."""
        return find_shortest_paths(self.reachable, self._cell_of(*self.start), RESOLUTION)

    def path_lengths(self, places: FloatArray) -> FloatArray:
        """Return the length of the path (n,) [m] to each of ``places`` (n, 2); inf for none.

        One search serves all places, so that a planner can compare any number of viewpoints.
        """
        cells = np.floor((places - self.origin) / RESOLUTION).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < self.cells.shape), axis=1)
        lengths = np.full(len(places), np.inf)
        index = np.ravel_multi_index(tuple(cells[inside].T), self.cells.shape)
        lengths[inside] = self._search[0][index]
        return lengths

    def is_feasible(self, x: float, y: float) -> bool:
        """Return whether the robot can reach (x, y) [m] and stand there."""
        i, j = self._cell_of(x, y)
        nx, ny = self.cells.shape
        return 0 <= i < nx and 0 <= j < ny and bool(self.reachable[i, j])

    def find_path(self, x: float, y: float) -> FloatArray | None:
        """Return the waypoints (n, 2) of a short path to (x, y) [m]; None if there is no path.

        Within the cell in which the robot stands, the path has no waypoints.
        """
        # Settle the simple cases
        if not self.is_feasible(x, y):
            return None
        if self._cell_of(x, y) == self._cell_of(*self.start):
            return np.zeros((0, 2))
        if self._clear(self.start, np.array([x, y])):
            return np.array([[x, y]])

        # Follow the search back
        _, before = self._search
        cells = [int(np.ravel_multi_index(self._cell_of(x, y), self.cells.shape))]
        while before[cells[-1]] >= 0:
            cells.append(int(before[cells[-1]]))

        # Shorten the path
        steps = np.stack(np.unravel_index(cells[::-1], self.cells.shape), axis=1)
        way = self.origin + (steps + 0.5) * RESOLUTION
        way[0], way[-1] = self.start, (x, y)
        return self._shortcut(way)[1:]

    def _shortcut(self, way: FloatArray) -> FloatArray:
        """Return only those waypoints that are needed to stay on passable cells."""
        kept, here = [0], 0
        while here < len(way) - 1:
            there = len(way) - 1
            while there > here + 1 and not self._clear(way[here], way[there]):
                there -= 1
            kept.append(there)
            here = there
        return way[kept]

    def _clear(self, a: FloatArray, b: FloatArray) -> bool:
        """Return whether the straight line from ``a`` to ``b`` stays on passable cells."""
        n = max(2, int(np.linalg.norm(b - a) / (RESOLUTION / 2)))
        points = a + np.linspace(0.0, 1.0, n)[:, None] * (b - a)
        cells = np.floor((points - self.origin) / RESOLUTION).astype(np.int64)
        return bool(np.all(self.passable[cells[:, 0], cells[:, 1]]))

    def _cell_of(self, x: float, y: float) -> tuple[int, int]:
        left, low = self._corner
        return math.floor((x - left) / RESOLUTION), math.floor((y - low) / RESOLUTION)

    @cached_property
    def _corner(self) -> tuple[float, float]:
        """The origin as plain numbers, faster for the many single viewpoints of a planner."""
        x, y = self.origin.tolist()
        return x, y

    def _cell(self, point: FloatArray) -> IntArray:
        return np.floor((point - self.origin) / RESOLUTION).astype(np.int64)

    def _disc(self, centre: FloatArray, radius: float) -> BoolArray:
        """Return the cells whose middle is within ``radius`` [m] of ``centre``."""
        # Restrict it to a window
        shape, reach = np.array(self.cells.shape), radius + RESOLUTION
        first = np.clip(self._cell(centre - reach), 0, shape)
        end = np.clip(self._cell(centre + reach) + 1, first, shape)
        i, j = (np.arange(a, b) for a, b in zip(first, end, strict=True))

        # Measure distances within the window
        x = self.origin[0] + (i[:, None] + 0.5) * RESOLUTION - centre[0]
        y = self.origin[1] + (j + 0.5) * RESOLUTION - centre[1]
        disc = np.zeros(self.cells.shape, dtype=bool)
        disc[first[0] : end[0], first[1] : end[1]] = np.hypot(x, y) <= radius
        return disc


class Floor(NamedTuple):
    """What one image shows of the floor.

    Attributes:
        obstacles: Top view (n, 2) of the things on it [m].
        reach: Distance to which each line sees it free (n_lines,) [m].
        yaws: Headings of the middle beams (n_lines,) [rad].
    """

    obstacles: FloatArray
    reach: FloatArray
    yaws: FloatArray


def build_costmap(
    observations: Sequence[Observation],
    config: Config,
    start: Pose2,
    touched: Sequence[tuple[float, float]] = (),
    workspace: Workspace | None = None,
) -> Costmap:
    """Return the costmap in ``odom`` from ``observations``; newer ones override older ones.

    Args:
        observations: Panoramas and sweeps in the order in which they were taken; at least one.
        config: Ranges, heights and the robot's size.
        start: Where the robot stands in ``odom``.
        touched: Places (x, y) [m] of obstacles, beside those that the observations name.
        workspace: Keeps what each image shows of the floor, for the next costmap.
    """
    # Cover all that was in range
    reach = config.target.max_range + RESOLUTION
    places = np.array([[o.T_odom_scan.x, o.T_odom_scan.y] for o in observations])
    origin = np.asarray(np.floor((places.min(axis=0) - reach) / RESOLUTION) * RESOLUTION)
    size = np.ceil((places.max(axis=0) + reach - origin) / RESOLUTION).astype(np.int64)
    cells = np.full(tuple(size), UNKNOWN, dtype=np.int64)

    # Mark what was seen and touched
    for observation in observations:
        _mark_observation(cells, origin, observation, config, workspace)
    _mark_cells(cells, origin, np.array(touched).reshape(-1, 2), TOUCHED)
    radius = config.motion.robot_radius + config.motion.clearance
    return Costmap(origin, cells, radius, np.array([start.x, start.y]))


def _mark_observation(
    cells: IntArray,
    origin: FloatArray,
    observation: Observation,
    config: Config,
    workspace: Workspace | None = None,
) -> None:
    """Write what one observation shows into ``cells``."""
    image, pose = observation.image, observation.T_odom_scan
    points, reach, yaws = _recall_floor(image, config, workspace)
    place = np.array([pose.x, pose.y, math.cos(pose.yaw), math.sin(pose.yaw)])
    done = engine.mark_floor(
        cells, *cells.shape, origin, RESOLUTION, place, yaws, reach, len(yaws), points, len(points)
    )
    if done < 0:
        raise MemoryError
    _mark_cells(cells, origin, np.array(observation.touched).reshape(-1, 2), TOUCHED)


def _mark_cells(cells: IntArray, origin: FloatArray, points: FloatArray, what: int) -> None:
    """Write ``what`` at ``points`` (n, 2) [m] into ``cells``, but not over touched ones."""
    if len(points) == 0:
        return
    columns = np.ascontiguousarray(points.T)
    i, j = np.floor((columns - origin[:, None]) / RESOLUTION).astype(np.int64)
    inside = (i >= 0) & (i < cells.shape[0]) & (j >= 0) & (j < cells.shape[1])
    i, j = i[inside], j[inside]
    cells[i, j] = np.where(cells[i, j] == TOUCHED, TOUCHED, what)


def _recall_floor(image: RangeImage, config: Config, workspace: Workspace | None) -> Floor:
    """Return ``_find_floor`` of an image, from the ``workspace`` if it is there already."""
    if workspace is None:
        return _find_floor(image, config)
    results, key = workspace.results_of(image), (Floor, config.target, config.motion)
    if key not in results:
        results[key] = _find_floor(image, config)
    floor: Floor = results[key]
    return floor


def _find_floor(image: RangeImage, config: Config) -> Floor:
    """Return what an image shows of the floor and of the things on it."""
    # Take the readings near the floor
    top = config.motion.robot_height + HEIGHT_MARGIN
    heights = image.heights
    with np.errstate(invalid="ignore"):
        low = (heights >= -config.target.floor_height) & (heights < top)
        low &= image.ranges_within(config.target.max_range)
    points, lines, beams, distance = SweepPoints.of(image, low)

    # Separate things from floor
    outside = distance > config.motion.self_radius
    solid = outside & (points[:, 2] > config.target.floor_height)
    ahead = outside & (np.abs(image.elevations_at(lines, beams)) < np.pi / 2)
    kinds = np.where(ahead, np.where(solid, SOLID, FLOOR), 0).astype(np.uint8)

    # Measure the free reach
    reach = _free_reach(lines, distance, kinds, image.n_lines, config)
    yaws = image.yaws[:, image.spec.n_beams // 2].copy()
    return Floor(np.ascontiguousarray(points[solid, :2]), reach, yaws)


def _free_reach(
    lines: IntArray, distance: FloatArray, kinds: ByteArray, n_lines: int, config: Config
) -> FloatArray:
    """Return the distance to which each line (n_lines,) sees a floor without gaps or things [m].

    Args:
        lines: Line of each reading (n,), ascending.
        distance: Distance of each reading in the top view (n,) [m].
        kinds: ``FLOOR``, ``SOLID`` or, for readings that show neither, 0 (n,).
        n_lines: Number of lines.
        config: Its robot radius is where the floor must begin.
    """
    reach = np.empty(n_lines)
    done = engine.measure_free_reach(
        lines, distance, kinds, len(lines), n_lines, config.motion.self_radius, FLOOR_STEP,
        RESOLUTION, reach,
    )  # fmt: skip
    if done < 0:
        raise MemoryError
    return reach
