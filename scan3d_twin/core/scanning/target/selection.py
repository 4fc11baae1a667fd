"""Target selection (paper section 4.2): the thing in a panorama that is to be digitised.

A free-standing thing has farther background on both its sides; the background itself does not.
Walls (``walls.py``) are groups of their own, so that what stands at a wall is separated from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.scanning.target.extraction import (
    WALL_REGISTRATION,
    extract_points,
    group_top_view,
    is_in_window,
    measure_pieces,
)
from scan3d_twin.core.scanning.target.walls import MIN_HEIGHT, Wall, find_walls
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Observation, RangeImage, Scan3D

MAX_WALL_INCIDENCE = math.radians(75.0)
"""Incidence up to which a step in depth between two lines may be on one wall [rad]."""
MIN_PROTRUSION = 0.20
"""Least distance by which a thing at a wall stands out from it [m]: more than what noise and the
error of its plane leave of the wall itself, three times ``WALL_REGISTRATION`` (assumption)."""
MIN_ROOM_WALLS = 3
"""Fewest walls in sight of a room: a corridor has two."""
MAX_COMPACT_SIZE = 3.5
"""Size up to which a target is preferred [m]; larger things are chosen if there is nothing else."""


@dataclass(frozen=True)
class _Group:
    """A thing in the panorama that may be the target.

    Attributes:
        points: Its top view in ``scan`` (n, 2) [m].
        salience: How much it stands out, see ``_measure_salience`` [m2].
        stands_free: Whether the background on both its sides is farther.
        compact: Whether it is no larger than ``MAX_COMPACT_SIZE``.
        at_wall: Whether the robot cannot pass between it and a wall.
    """

    points: FloatArray
    salience: float
    stands_free: bool = False
    compact: bool = False
    at_wall: bool = False

    @property
    def rank(self) -> int:
        """2 for a compact thing in the open, 1 for others in front of the background, 0 for it."""
        return self.stands_free * (1 + (self.compact and not self.at_wall))


def find_target(
    panorama: Observation, near: tuple[float, float] | None, config: Config
) -> FloatArray:
    """Return the top view (n, 2) in ``odom`` [m] of the target in a panorama.

    Args:
        panorama: The panorama.
        near: Place (x, y) in ``odom`` of the wanted target [m]. None chooses the most salient
            thing: a free-standing one, preferably no larger than ``MAX_COMPACT_SIZE``, with the
            largest face towards the robot, ahead rather than behind.
        config: Thresholds.

    Raises:
        SceneError: Nothing was seen, or nothing near ``near``.
    """
    groups = _find_groups(panorama, config)
    if near is not None:
        return _choose_nearest(groups, panorama, near)
    best = max(groups, key=lambda group: (group.rank, group.salience))
    return panorama.T_odom_scan.apply(best.points)


def find_targets(panorama: Observation, count: int, config: Config) -> list[FloatArray]:
    """Return the top views (n, 2) in ``odom`` [m] of the most salient things, at most ``count``.

    All but the first must be free-standing; see ``find_target``.

    Raises:
        SceneError: Nothing was seen.
    """
    groups = sorted(
        _find_groups(panorama, config), key=lambda g: (g.rank, g.salience), reverse=True
    )
    free = [group for group in groups if group.rank > 0]
    return [panorama.T_odom_scan.apply(group.points) for group in (free or groups[:1])[:count]]


def is_empty(panorama: Observation, config: Config) -> bool:
    """Return whether a panorama shows nothing, or a room in which nothing stands.

    Nobody wants a model of that: a thin thing has fallen between two lines.
    """
    try:
        groups = _find_groups(panorama, config)
    except SceneError:
        return True
    if any(group.rank for group in groups):
        return False
    points = extract_points(panorama.image, config).points
    return len(find_walls(points, config.target.max_range)) >= MIN_ROOM_WALLS


def _find_groups(panorama: Observation, config: Config) -> list[_Group]:
    """Return the things in a panorama, at least one."""
    # Select the points in the window
    image, everything = panorama.image, extract_points(panorama.image, config)
    sweep = everything.select(
        is_in_window(image, everything.lines, everything.beams, config.target)
    )
    least = count_least_points(config)
    if len(sweep) < least:
        raise SceneError(
            f"no target: the panorama shows nothing within {config.target.max_range:g} m; "
            "start the robot nearer to the target"
        )

    # Leave out stray points
    sweep = sweep.select(measure_pieces(image, sweep) >= least)
    if len(sweep) == 0:
        raise SceneError("no target: the panorama shows only stray points")
    foremost = _find_nearest_per_line(sweep.points, sweep.lines, image.n_lines)

    # Separate the walls
    top, limit = sweep.points[:, :2], config.target.max_range
    walls = {
        wall: on_wall
        for wall in find_walls(everything.points, limit)
        if (on_wall := wall.contains(top, WALL_REGISTRATION)).any()
        and not _stands_free(image, sweep, on_wall, foremost, limit)
    }

    # Group the rest in the top view
    rest = ~np.any([np.zeros(len(sweep), dtype=bool), *walls.values()], axis=0)
    distance = float(np.median(np.linalg.norm(top, axis=1)))
    gap = config.target.cluster_gap + distance * _measure_line_spacing(image)
    labels = np.full(len(sweep), -1)
    labels[rest] = group_top_view(top[rest], gap) if rest.any() else 0
    members = [labels == label for label in np.unique(labels[rest])]
    members = [member for member in members if np.count_nonzero(member) >= least]

    # Describe groups and walls
    passage = 2 * (config.motion.robot_radius + config.motion.clearance)

    def describe(member: BoolArray) -> _Group:
        return _describe_group(image, sweep, member, foremost, limit, list(walls), passage)

    groups = [describe(member) for member in members]
    pieces = [
        member for member, group in zip(members, groups, strict=True) if not group.stands_free
    ]
    groups = [group for group in groups if group.stands_free]
    groups += [describe(thing) for thing in _join_pieces(image, sweep, pieces, foremost)]
    groups += [
        _Group(top[on_wall], _measure_salience(image, sweep.points[on_wall]))
        for on_wall in walls.values()
    ]
    return groups


def _join_pieces(
    image: RangeImage, sweep: Scan3D, pieces: list[BoolArray], foremost: FloatArray
) -> list[BoolArray]:
    """Return the things (n,) that ``pieces`` (n,) make, none of which stands free by itself.

    The lines on a face that recedes are farther apart than what separates groups, and so are two
    faces with a step between them. Where no line passes between two pieces, and the step from one
    to the other may be that of a surface, they are one thing.

    Args:
        image: The panorama.
        sweep: Its n points.
        pieces: Which points are of each piece.
        foremost: Distance of the nearest point in each line (n_lines,) [m].
    """
    # Find whose point is the foremost one of each line
    owner = np.full(image.n_lines, -1)
    for k, piece in enumerate(pieces):
        own = _find_nearest_per_line(sweep.points[piece], sweep.lines[piece], image.n_lines)
        owner[np.isfinite(own) & (own <= foremost)] = k

    # Join what goes on from one line to the next
    label, most = np.arange(len(pieces)), 1 + _limit_wall_step(image)
    for line, (a, b) in enumerate(zip(np.roll(owner, 1), owner, strict=True)):
        before, here = foremost[line - 1], foremost[line]
        if min(a, b) >= 0 and max(before, here) <= most * min(before, here):
            label[label == label[b]] = label[a]
    return [
        np.any([pieces[k] for k in np.flatnonzero(label == thing)], axis=0)
        for thing in np.unique(label)
    ]


def count_least_points(config: Config) -> int:
    """Return the number of points below which a group in a panorama is stray points.

    Its lines are farther apart than those of a sweep, for which ``min_points`` is meant.
    """
    share = min(1.0, config.sweep.yaw_rate / config.sweep.look_rate)
    return max(1, math.ceil(config.target.min_points * share))


def _choose_nearest(
    groups: list[_Group], panorama: Observation, near: tuple[float, float]
) -> FloatArray:
    """Return the top view (n, 2) in ``odom`` of the group nearest to ``near``, within half a metre.

    Raises:
        SceneError: No group is so near.
    """
    limit = 0.5
    views = [panorama.T_odom_scan.apply(group.points) for group in groups]
    distances = [float(np.min(np.linalg.norm(view - near, axis=1))) for view in views]
    if not distances or min(distances) > limit:
        raise SceneError(
            f"no target within {limit} m of ({near[0]:.2f}, {near[1]:.2f}); the place is meant in "
            "metres from where the robot starts, x ahead and y to the left"
        )
    return views[int(np.argmin(distances))]


def _describe_group(
    image: RangeImage,
    sweep: Scan3D,
    member: BoolArray,
    foremost: FloatArray,
    max_range: float,
    walls: list[Wall],
    passage: float,
) -> _Group:
    """Return the group of the points that are ``member`` (n,) of it, with its salience.

    A side of it that goes back to a wall ends there: that wall is background, near as it is.
    """
    # Find the walls at which it stands
    points = sweep.points[member]
    near = [wall for wall in walls if wall.contains(points[:, :2], passage).any()]
    behind = [wall for wall in near if _protrudes(points, wall)]

    # Take them for far away
    if behind:
        on_wall = np.any(
            [wall.contains(sweep.points[:, :2], WALL_REGISTRATION) for wall in behind], axis=0
        )
        distance = _find_nearest_per_line(
            sweep.points[on_wall], sweep.lines[on_wall], len(foremost)
        )
        foremost = np.where(foremost < distance, foremost, math.inf)

    return _Group(
        points[:, :2],
        _measure_salience(image, points),
        _stands_free(image, sweep, member, foremost, max_range),
        float(np.max(np.ptp(points[:, :2], axis=0))) <= MAX_COMPACT_SIZE,
        bool(near),
    )


def _protrudes(points: FloatArray, wall: Wall) -> bool:
    """Return whether ``points`` (n, 3) stand out from ``wall``, and none of them is behind it.

    A ceiling does so too, but it does not stand.
    """
    if points[:, 2].min() >= MIN_HEIGHT:
        return False
    distance = wall.distance(points[:, :2])
    return bool(distance.max() >= MIN_PROTRUSION and distance.min() > -WALL_REGISTRATION)


def _stands_free(
    image: RangeImage, sweep: Scan3D, member: BoolArray, foremost: FloatArray, max_range: float
) -> bool:
    """Return whether the background beyond both ends of the ``member`` points (n,) is farther.

    The distances to what is ``foremost`` in each line (n_lines,) [m] tell where that is.
    What is beyond ``max_range`` [m] is not seen: a wall that goes on there does not stand free.
    """
    # Find the ends among the lines
    own = _find_nearest_per_line(sweep.points[member], sweep.lines[member], image.n_lines)
    lines = np.flatnonzero(np.isfinite(own))
    gaps = np.diff(np.append(lines, lines[0] + image.n_lines))
    widest = int(np.argmax(gaps))
    if gaps[widest] <= 1:
        return False

    # Compare with what is beyond
    right, left = lines[widest], lines[(widest + 1) % len(lines)]
    beyond = np.minimum(foremost[[(right + 1) % image.n_lines, left - 1]], max_range)
    return bool(np.all(beyond > own[[right, left]] * (1 + _limit_wall_step(image))))


def _measure_salience(image: RangeImage, points: FloatArray) -> float:
    """Return the area [m2] that ``points`` (n, 3) show to the robot, weighted by their bearing.

    The area counts, not the solid angle: a near twig is not more salient than a box behind it. The
    weight falls from 1 ahead to 0 behind, as people place a robot so that it faces its target.
    """
    beams = float(np.median(np.abs(np.diff(image.spec.elevations))))
    area = float(np.sum(points[:, :2] ** 2)) * _measure_line_spacing(image) * beams
    x, y = points[:, :2].mean(axis=0)
    ahead = (1.0 + float(x) / max(math.hypot(float(x), float(y)), 1e-9)) / 2
    return area * ahead


def _limit_wall_step(image: RangeImage) -> float:
    """Return the relative step from line to line of a wall seen at ``MAX_WALL_INCIDENCE``."""
    return math.tan(MAX_WALL_INCIDENCE) * _measure_line_spacing(image)


def _measure_line_spacing(image: RangeImage) -> float:
    """Return the typical angle between two lines [rad]."""
    return float(np.median(-np.diff(image.yaws[:, image.spec.n_beams // 2])))


def _find_nearest_per_line(points: FloatArray, lines: IntArray, n_lines: int) -> FloatArray:
    """Return the smallest horizontal distance in each line (n_lines,) [m]; inf for no point."""
    distances = np.full(n_lines, math.inf)
    np.minimum.at(distances, lines, np.hypot(points[:, 0], points[:, 1]))
    return distances
