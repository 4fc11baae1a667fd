"""A log of a real URG-04LX that stands, and the room that it saw, rebuilt for the twin.

The log is that of the BreezySLAM examples: one scan a line, with the time [us] in column 0, wheel
ticks in 2 and 3, and the 682 readings of steps 44 to 725 from 24 on. A *stretch* is a run of lines
in which the robot stands. Its walls are lines fitted to the readings in the frame of the sensor, so
the log's pose is the origin of each stretch's room, and no error of a map is in them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.device import URG04LX

TICKS, READINGS = slice(2, 4), slice(24, 24 + 682)
"""Columns of the log."""
MIN_LINES = 3
"""Fewest lines of a stretch."""
JUMP_MM = 150
"""Difference of the distances of two steps from which on a depth edge lies between them [mm]."""
MARGIN_MM = 10
"""A mixed pixel lies between its neighbours by more than the noise [mm]."""
TOLERANCE_MM = 8.0
"""Largest distance of a reading from the wall fitted to it [mm]: three standard deviations of a
median of eight readings."""
HALF_WALL_THICKNESS = 0.002
"""Half the thickness of the walls of the rebuilt room [m]; they lie behind their faces."""
FAR_WALL = 6.5
"""Distance at which directions of the code ``TOO_FAR`` have a wall [m], beyond
``DETECTED_RANGE_MM``; assumption."""
DARK_WALL = 3.9
"""Distance at which directions without readings have a dark surface [m]; assumption."""
DARK_STEPS = 8
"""Width of one such surface in steps; assumption, 0.2 m at ``DARK_WALL``."""
LIDAR_HEIGHT = 1.0
"""Height of the level scan plane [m]; the floor must be out of sight."""
MAX_REDRAWS = 100
"""Most draws of a reflectance; a wall that needs more is too weak for the twin at any."""
ANGLES = np.asarray(URG04LX.spec("usb").elevations)
"""Angles of the steps (682,) [rad]; the log's sensor lies flat."""
STEP = math.tau / urg04lx.STEPS_PER_TURN


@dataclass(frozen=True)
class Stretch:
    """Lines of a sensor that stands.

    Attributes:
        readings: Distances [mm] or codes below 20 (m, 682); a distance beyond the sensor's
            ``MAX_RANGE_MM``, which the twin cannot send, is code 0.
        measured: The same with these distances (m, 682).
    """

    readings: IntArray
    measured: IntArray


@dataclass(frozen=True)
class Wall:
    """A flat face, and the steps that see it.

    Attributes:
        first: First step that sees it.
        last: Last step that sees it, inclusive.
        ends: Its ends in the frame of the sensor (2, 2) [m].
        reflectance: Its diffuse reflectance; None is that of unpainted geoms.
    """

    first: int
    last: int
    ends: FloatArray
    reflectance: float | None = None

    def incidence(self) -> float:
        """Return the angle [rad] between the middle step and the wall's normal."""
        along = self.ends[1] - self.ends[0]
        along = along / np.linalg.norm(along)
        angle = ANGLES[(self.first + self.last) // 2]
        return math.asin(min(1.0, abs(float(along @ (math.cos(angle), math.sin(angle))))))


def read_stretches(path: Path) -> tuple[list[Stretch], FloatArray]:
    """Return the stretches of a log, and the times at which the host got its lines (n,) [s].

    A line counts as standing where the wheels turned neither since the line before nor until the
    line after: a line whose first ticks equal those of its neighbour was read in part on the move.
    """
    rows = np.array([line.split() for line in path.read_text().splitlines()], dtype=float)
    stands = np.all(np.diff(rows[:, TICKS], axis=0) == 0, axis=1)
    still = np.concatenate([[True], stands]) & np.concatenate([stands, [True]])
    measured = rows[:, READINGS].astype(np.int64)
    readings = np.where(measured > urg04lx.MAX_RANGE_MM, urg04lx.NO_RETURN, measured)
    stretches = [
        Stretch(readings[i:j], measured[i:j]) for i, j in find_runs(still) if j - i >= MIN_LINES
    ]
    return stretches, rows[:, 0] / 1e6


def find_runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return start and end (exclusive) of each run of True in ``flags`` (n,)."""
    padded = np.concatenate([[False], flags, [False]])
    changes = np.flatnonzero(padded[1:] != padded[:-1])
    return list(zip(changes[::2].tolist(), changes[1::2].tolist(), strict=True))


def fit_walls(stretch: Stretch) -> list[Wall]:
    """Return the walls that a stretch shows, in the order of its steps."""
    ranges = _find_typical_ranges(stretch)
    ranges[_find_mixed(ranges)] = np.nan
    walls: list[Wall] = []
    edge = np.abs(np.diff(ranges)) > JUMP_MM
    for first, end in find_runs(np.isfinite(ranges)):
        cuts = [first, *(first + 1 + np.flatnonzero(edge[first : end - 1])).tolist(), end]
        for start, stop in itertools.pairwise(cuts):
            walls += [_fit_wall(ranges, i, j) for i, j in _split_run(ranges, start, stop)]
    return walls


def _find_typical_ranges(stretch: Stretch) -> FloatArray:
    """Return the median distance of each step (682,) [mm]; NaN where most lines have none."""
    valid = stretch.measured >= urg04lx.MIN_RANGE_MM
    known = valid.mean(axis=0) >= 0.5
    ranges = np.full(stretch.measured.shape[1], np.nan)
    values = np.where(valid, stretch.measured, np.nan)[:, known]
    ranges[known] = np.nanmedian(values, axis=0)
    return ranges


def _find_mixed(ranges: FloatArray) -> BoolArray:
    """Return which of ``ranges`` (n,) lie between their neighbours at a depth edge."""
    result = np.zeros(len(ranges), dtype=bool)
    left, middle, right = ranges[:-2], ranges[1:-1], ranges[2:]
    low, high = np.minimum(left, right) + MARGIN_MM, np.maximum(left, right) - MARGIN_MM
    with np.errstate(invalid="ignore"):
        result[1:-1] = (np.abs(right - left) > JUMP_MM) & (low < middle) & (middle < high)
    return result


def _place_points(ranges: FloatArray, first: int, end: int) -> FloatArray:
    """Return the points (n, 2) [mm] of the steps ``first`` to ``end`` (exclusive)."""
    angles = ANGLES[first:end]
    return ranges[first:end, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _split_run(ranges: FloatArray, first: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the straight parts of a run of steps (Ramer 1972, Douglas and Peucker 1973)."""
    points = _place_points(ranges, first, end)
    along = points[-1] - points[0]
    length = float(np.linalg.norm(along))
    if len(points) > 2 and length > 0:
        off = points - points[0]
        away = np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]) / length
        worst = int(np.argmax(away[1:-1])) + 1
        if away[worst] > TOLERANCE_MM:
            yield from _split_run(ranges, first, first + worst)
            yield from _split_run(ranges, first + worst, end)
            return
    yield first, end


def _fit_wall(ranges: FloatArray, first: int, end: int) -> Wall:
    """Return the wall of these steps, out to half a step beyond them.

    A wall of fewer than three steps, or seen too flat, faces the sensor.
    """
    points = _place_points(ranges, first, end)
    centre = points.mean(axis=0)
    sight = centre / np.linalg.norm(centre)
    normal = sight
    if len(points) >= 3:
        normal = np.linalg.svd(points - centre)[2][1]
        normal = normal if abs(normal @ sight) > math.cos(math.radians(86)) else sight
    bounds = ANGLES[[first, end - 1]] + STEP * np.array([-0.5, 0.5])
    rays = np.stack([np.cos(bounds), np.sin(bounds)], axis=1)
    reach = (normal @ centre) / (rays @ normal)
    return Wall(first, end - 1, rays * reach[:, None] / 1000)


@dataclass(frozen=True)
class Reflectances:
    """An assumption on the diffuse reflectance of a room's surfaces: log-normal.

    Attributes:
        seen: Median of the surfaces that the real sensor sees; those that would return less than
            the threshold, or have more than 1, are drawn again.
        seen_spread: Standard deviation of its logarithm.
        unseen: Median of the surfaces in directions in which it sees nothing.
        unseen_spread: Standard deviation of its logarithm.
    """

    seen: float
    seen_spread: float
    unseen: float
    unseen_spread: float


def assign_reflectances(
    walls: list[Wall], assumed: Reflectances, threshold: float, rng: np.random.Generator
) -> list[Wall]:
    """Return ``walls``, which the real sensor sees, with drawn reflectances.

    Args:
        walls: The walls.
        assumed: Their distribution.
        threshold: Weakest return that the twin's sensor detects; ``LidarModelConfig.threshold``.
        rng: Source of the draws.
    """
    result = []
    for wall in walls:
        distance = float(np.linalg.norm(wall.ends.mean(axis=0)))
        least = math.pi * threshold * distance**2 / max(math.cos(wall.incidence()), 0.05)
        reflectance = min(1.0, least)
        for _ in range(MAX_REDRAWS):
            drawn = assumed.seen * math.exp(assumed.seen_spread * rng.standard_normal())
            if least < drawn <= 1:
                reflectance = drawn
                break
        result.append(replace(wall, reflectance=reflectance))
    return result


def build_unseen_walls(
    stretch: Stretch, walls: list[Wall], assumed: Reflectances, rng: np.random.Generator
) -> list[Wall]:
    """Return walls in the directions in which a stretch measured nothing.

    Directions of the code ``TOO_FAR`` get a wall at ``FAR_WALL``, the others dark surfaces at
    ``DARK_WALL``.
    """
    seen = np.zeros(stretch.readings.shape[1], dtype=bool)
    for wall in walls:
        seen[wall.first : wall.last + 1] = True
    far = (stretch.measured == urg04lx.TOO_FAR).mean(axis=0) >= 0.5
    result = [_build_facing_wall(i, j, FAR_WALL, None) for i, j in find_runs(far & ~seen)]
    for first, end in find_runs(~(far | seen)):
        for start in range(first, end, DARK_STEPS):
            drawn = assumed.unseen_spread * rng.standard_normal()
            stop, dark = min(end, start + DARK_STEPS), assumed.unseen * math.exp(drawn)
            result.append(_build_facing_wall(start, stop, DARK_WALL, dark))
    return result


def _build_facing_wall(first: int, end: int, distance: float, reflectance: float | None) -> Wall:
    """Return a wall at ``distance`` [m] that spans these steps."""
    bounds = ANGLES[[first, end - 1]] + STEP * np.array([-0.5, 0.5])
    ends = distance * np.stack([np.cos(bounds), np.sin(bounds)], axis=1)
    return Wall(first, end - 1, ends, reflectance)


def write_room(walls: list[Wall]) -> str:
    """Return ``walls`` as MJCF: thin upright boxes around a sensor at ``LIDAR_HEIGHT``."""
    materials, geoms = [], []
    for k, wall in enumerate(walls):
        middle, along = wall.ends.mean(axis=0), wall.ends[1] - wall.ends[0]
        length = float(np.linalg.norm(along))
        behind = np.array([along[1], -along[0]]) / length
        behind *= math.copysign(1.0, float(behind @ middle))
        x, y = middle + HALF_WALL_THICKNESS * behind
        yaw = math.degrees(math.atan2(along[1], along[0]))
        look = ""
        if wall.reflectance is not None:
            shade = f"{wall.reflectance:.6f}"
            look = f' material="m{k}"'
            materials.append(f'<material name="m{k}" roughness="1" rgba="{shade} 0 0 1"/>')
        geoms.append(
            f'<geom name="wall{k}" type="box" pos="{x:.6f} {y:.6f} {LIDAR_HEIGHT}" '
            f'size="{length / 2:.6f} {HALF_WALL_THICKNESS} 0.5" euler="0 0 {yaw:.6f}"{look}/>'
        )
    target = '<geom name="target" type="box" pos="50 0 1" size=".1 .1 .1"/>'
    return (
        f"<mujoco><asset>{''.join(materials)}</asset><worldbody>"
        f'<site name="spawn"/>{target}{"".join(geoms)}</worldbody></mujoco>'
    )
