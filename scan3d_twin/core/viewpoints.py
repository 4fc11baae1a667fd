"""Geometry of viewpoints (paper Fig. 8): the target's contour, and where to stand next.

All in the top view of frame ``scan``, left to right as the robot sees it; the robot travels to the
right, so counter-clockwise around the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage, Scan3D

BREAK = 4.0
"""A step between two lines of more than this many median steps is a depth edge, not surface."""
NORMAL_REACH = 4
"""Lines on each side from which a local normal is taken; 3.5 cm at 0.5 deg and 1 m."""
MAX_INCIDENCE = math.radians(65.0)
"""Q is seen from O2 at no flatter angle than this from its mean normal; beyond about 70 deg the
URG-04LX returns gross errors (UBG-04LX-F01 data, 80 deg)."""


@dataclass(frozen=True)
class Contour:
    """Top view of a target, one point per line, left to right.

    Attributes:
        points: (n, 2) [m].
        normals: Outward unit normals (n, 2), towards the robot.
        arc: Length of surface from the first point (n,) [m]; jumps in depth do not count.
    """

    points: FloatArray
    normals: FloatArray
    arc: FloatArray

    @property
    def width(self) -> float:
        """Length of the whole segment [m]: the paper's S1."""
        return float(self.arc[-1])


def contour_of(scan: Scan3D) -> Contour:
    """Return the contour of a target scan: the mean top-view point of each of its lines."""
    count = np.bincount(scan.lines, minlength=scan.n_lines)
    sums = [np.bincount(scan.lines, scan.points[:, i], scan.n_lines) for i in (0, 1)]
    lines = scan.occupied_lines
    return trace(np.stack([total[lines] / count[lines] for total in sums], axis=1))


def trace(points: FloatArray) -> Contour:
    """Return the contour through ``points`` (n, 2), given left to right around the origin."""
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    surface = lengths <= BREAK * max(typical, 1e-9)
    arc = np.concatenate(([0.0], np.cumsum(np.where(surface, lengths, typical))))
    return Contour(points, _normals(points, surface), arc)


def _normals(points: FloatArray, surface: np.ndarray) -> FloatArray:
    """Return for each point the normal of the surface piece it lies on, towards the origin."""
    piece = np.concatenate(([0], np.cumsum(~surface)))
    normals = np.empty_like(points)
    for i in range(len(points)):
        near = np.arange(max(0, i - NORMAL_REACH), min(len(points), i + NORMAL_REACH + 1))
        near = near[piece[near] == piece[i]]
        normals[i] = _line_normal(points[near]) if len(near) > 2 else -_unit(points[i])
    return normals


def _line_normal(points: FloatArray) -> FloatArray:
    """Return the unit normal (2,) of the best line through ``points``, towards the origin."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    return np.asarray(-normal if normal @ points.mean(axis=0) > 0 else normal)


def ends_in_view(image: RangeImage, sweep: Scan3D, target: Scan3D, gap: float) -> bool:
    """Tell whether the target's right end is a silhouette: nothing nearer follows for ``gap`` [m].

    Args:
        image: The range image.
        sweep: All its points except the floor.
        target: The target's points among them.
        gap: Width beyond the end that has to be clear at the end's distance [m].
    """
    last = int(target.occupied_lines[-1])
    end = target.points[target.lines == last, :2]
    distance = float(np.median(np.hypot(end[:, 0], end[:, 1])))
    yaws = image.yaws[:, image.spec.n_beams // 2]
    if yaws[last] - yaws[-1] < gap / distance:
        return False
    beyond = sweep.points[(sweep.lines > last) & (yaws[sweep.lines] > yaws[last] - gap / distance)]
    return bool(np.all(np.hypot(beyond[:, 0], beyond[:, 1]) > distance))


@dataclass(frozen=True)
class Segment:
    """The next segment of surface to scan.

    Attributes:
        middle: (2,) [m].
        normal: Outward unit normal (2,).
    """

    middle: FloatArray
    normal: FloatArray

    def viewpoint(self, standoff: float, turn: float = 0.0) -> Pose2:
        """Return the pose facing the middle from ``standoff`` [m], off the normal by ``turn`` [rad]."""
        direction = Pose2(0.0, 0.0, turn).apply(self.normal)
        place = self.middle + standoff * direction
        return Pose2(float(place[0]), float(place[1]), math.atan2(-direction[1], -direction[0]))


def next_segment(contour: Contour, n_Q: int, turns_away: bool) -> Segment:
    """Return the segment that begins where Q begins and is as wide as S1 (Fig. 8).

    Its outward normal is the mean over the segment. Beyond what was seen the surface is taken to go
    on straight, or, where ``turns_away``, to turn a convex right-angled corner at the silhouette.

    Args:
        contour: Of the current target scan P.
        n_Q: Number of overlapping lines.
        turns_away: Whether the target ends at the last line, so that what follows is hidden.
    """
    first = len(contour.points) - n_Q
    known = contour.width - float(contour.arc[first])
    unknown = contour.width - known
    normal_known = _unit(contour.normals[first:].mean(axis=0))
    end, normal_end = contour.points[-1], _unit(contour.normals[-NORMAL_REACH:].mean(axis=0))
    normal_next = _to_the_right(normal_end) if turns_away else normal_end
    middle = _along(contour, first, end, _to_the_right(normal_next), contour.width / 2)
    normal = _unit(known * normal_known + unknown * normal_next)
    return Segment(middle, _limit(normal, normal_known))


def first_segment(points: FloatArray, width: float, from_left: bool) -> Segment:
    """Return the segment to start with, from the coarse top view of a look around.

    Args:
        points: Top view (n, 2) of the target around the robot at the origin [m].
        width: Length of surface that one sweep covers [m].
        from_left: Whether to begin at the target's left end; else in front of its middle.
    """
    contour = trace(_left_to_right(points))
    begin = 0.0 if from_left else max(0.0, (contour.width - width) / 2)
    inside = (contour.arc >= begin) & (contour.arc <= begin + width)
    part = contour.points[inside]
    middle = np.array(
        [
            np.interp(begin + min(width, contour.width) / 2, contour.arc, contour.points[:, i])
            for i in (0, 1)
        ]
    )
    normal = _line_normal(part) if len(part) > 2 else -_unit(middle)
    return Segment(middle, normal)


def _left_to_right(points: FloatArray) -> FloatArray:
    """Return the mean point of each bearing of a coarse top view, from left to right."""
    bearings = np.arctan2(points[:, 1], points[:, 0])
    middle = math.atan2(float(np.sin(bearings).mean()), float(np.cos(bearings).mean()))
    bearings = (bearings - middle + np.pi) % (2 * np.pi)
    order = np.argsort(-bearings, kind="stable")
    groups = np.cumsum(np.diff(-bearings[order], prepend=-bearings[order[0]]) > np.radians(1.0))
    count = np.bincount(groups)
    return np.stack([np.bincount(groups, points[order, i]) / count for i in (0, 1)], axis=1)


def alternatives(segment: Segment, config: Config) -> Iterator[Pose2]:
    """Yield viewpoints for ``segment``: the wanted one, then nearer, farther and turned ones."""
    turns = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
    factors = (1.0, 0.85, 1.15, 0.7, 1.3, 0.55)
    order = sorted(
        (abs(turn) / 30.0 + abs(factor - 1.0) / 0.3, turn, factor)
        for turn in turns
        for factor in factors
    )
    for _, turn, factor in order:
        yield segment.viewpoint(factor * config.planning.standoff, math.radians(turn))


def place(
    segment: Segment, config: Config, feasible: Callable[[Pose2], bool]
) -> tuple[Pose2 | None, bool]:
    """Return the best feasible viewpoint for ``segment`` and whether it is the wanted one."""
    for k, viewpoint in enumerate(alternatives(segment, config)):
        if feasible(viewpoint):
            return viewpoint, k == 0
    return None, False


def _along(
    contour: Contour, first: int, end: FloatArray, tangent: FloatArray, length: float
) -> FloatArray:
    """Return the point ``length`` [m] after line ``first``, straight on beyond ``end``."""
    wanted = float(contour.arc[first]) + length
    if wanted > contour.width:
        return np.asarray(end + (wanted - contour.width) * tangent)
    return np.array([np.interp(wanted, contour.arc, contour.points[:, i]) for i in (0, 1)])


def _limit(normal: FloatArray, reference: FloatArray) -> FloatArray:
    """Return ``normal``, turned towards ``reference`` to within ``MAX_INCIDENCE`` of it."""
    angle = math.atan2(
        reference[0] * normal[1] - reference[1] * normal[0], float(reference @ normal)
    )
    if abs(angle) <= MAX_INCIDENCE:
        return normal
    return Pose2(0.0, 0.0, math.copysign(MAX_INCIDENCE, angle)).apply(reference)


def _to_the_right(normal: FloatArray) -> FloatArray:
    """Return ``normal`` turned a quarter counter-clockwise.

    For a robot that looks against ``normal`` this is the direction along the face to its right, and
    also the outward normal of the face around a right-angled convex corner there.
    """
    return np.array([-normal[1], normal[0]])


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
