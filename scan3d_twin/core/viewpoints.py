"""Geometry of viewpoints (paper Fig. 8): the target's contour, and where to stand next.

Everything is in the top view of frame ``scan``, left to right as the robot sees it. The robot
travels to the right, that is counter-clockwise around the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.types import FloatArray, IntArray, Pose2, RangeImage, Scan3D, wrap

MAX_INCIDENCE = math.radians(65.0)
"""Largest incidence at which Q is seen from O2, from its mean normal [rad]; beyond about 70 deg the
URG-04LX returns gross errors (UBG-04LX-F01 data, 80 deg)."""
DIRECTION_LINES = 6
"""Lines at the end of the contour from which the direction of the surface there is taken."""
CORNER_ANGLE = math.radians(30.0)
"""Bend above which a surface has turned a corner [rad]."""
STRAIGHT_ANGLE = math.radians(5.0)
"""Angle between the halves of a contour below which it is straight [rad]; noise makes 1 or 2
deg."""
SILHOUETTE_TURN = math.radians(90.0)
"""Angle by which a surface that ends in view turns away beyond its end [rad]: it ends as a
silhouette, either at an edge, behind which faces are mostly at right angles, or along a curve."""
MAX_FRONT_ANGLE = math.radians(45.0)
"""Largest angle to either side from which a tour of the front looks at the front [rad]."""
NEARLY_ROUND = math.radians(240.0)
"""Turn since the first view after which the latest one may see the same surface again, so that the
loop may close [rad]; three sides of a box are 270 deg."""
_ALTERNATIVES = tuple(
    (turn, factor)
    for _, turn, factor in sorted(
        (abs(turn) / 30.0 + abs(factor - 1.0) / 0.3, turn, factor)
        for turn in (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
        for factor in (1.0, 0.85, 1.15, 0.7, 1.3, 0.55)
    )
)
"""Alternative viewpoints: turns off a segment's normal [deg] and factors on the standoff, the
smallest change first."""
_OBLIQUE_TURNS = tuple(math.radians(turn) for turn in (15.0, 30.0, 45.0))
"""Turns off a segment's normal, onwards, from which a corner may show both of its faces [rad].
Turned back, a viewpoint is where the robot has been: errors are small there, and it gets
nowhere."""
TOWARDS_ROBOT = np.array([-1.0, 0.0])
"""Direction in ``scan`` from the middle of the sweep towards the robot."""


@dataclass(frozen=True)
class Contour:
    """Convex top-view envelope of a target towards the robot, one point per line, left to right.

    The envelope spans gaps and niches: the robot travels along it, not into them.

    Attributes:
        points: Intersection of each line with the envelope (n, 2) [m].
        arc: Length along the envelope from the first point (n,) [m].
    """

    points: FloatArray
    arc: FloatArray

    @property
    def width(self) -> float:
        """Length of the whole segment [m]: the paper's S1."""
        return float(self.arc[-1])

    def normal(self, first: int, last: int = -1) -> FloatArray:
        """Return the outward unit normal (2,) of the chord between two points."""
        chord = self.points[last] - self.points[first]
        return _unit(rotate_clockwise(chord)) if chord.any() else -_unit(self.points[first])


def count_well_seen(contour: Contour) -> int:
    """Return the number of lines, from the left, before the surface turns too flat on the right.

    Lines at grazing incidence are noisy and far apart: a poor basis for an overlap.
    """
    n = len(contour.points)
    for k in range(n, 1, -1):
        normal = contour.normal(max(0, k - DIRECTION_LINES), k - 1)
        if measure_angle(normal, -contour.points[k - 1]) > -MAX_INCIDENCE:
            return k
    return n


def has_corner_after(contour: Contour, k: int) -> bool:
    """Return whether the surface turns a corner after the first ``k`` lines."""
    if k >= len(contour.points):
        return False
    return measure_angle(contour.normal(0, k - 1), contour.normal(k)) > CORNER_ANGLE


def extract_contour(scan: Scan3D) -> Contour:
    """Return the contour of a target scan, from the mean top-view point of each of its lines."""
    return trace_contour(average_lines(scan))


def average_lines(scan: Scan3D) -> FloatArray:
    """Return the mean top-view point (n, 2) of each occupied line [m]."""
    count = np.bincount(scan.lines, minlength=scan.n_lines)
    sums = [np.bincount(scan.lines, scan.points[:, i], scan.n_lines) for i in (0, 1)]
    lines = np.flatnonzero(count)
    return np.stack([total[lines] / count[lines] for total in sums], axis=1)


def trace_contour(points: FloatArray) -> Contour:
    """Return the contour of ``points`` (n, 2), given left to right around the origin."""
    # Find each line's edge of the hull
    kept = _find_convex_hull(points)
    edge = np.clip(np.searchsorted(kept, np.arange(len(points)), side="right") - 1, 0, None)
    a = points[kept[np.minimum(edge, len(kept) - 1)]]
    b = points[kept[np.minimum(edge + 1, len(kept) - 1)]]

    # Intersect the lines with their edges
    across = _cross(b - a, points)
    share = np.divide(_cross(points, a), across, out=np.zeros(len(points)), where=across != 0)
    envelope = a + np.clip(share, 0.0, 1.0)[:, None] * (b - a)
    steps = np.diff(envelope, axis=0)
    return Contour(envelope, np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))))


def _find_convex_hull(points: FloatArray) -> IntArray:
    """Return the indices of the points on the convex hull's side towards the origin."""
    places = points.tolist()
    kept: list[int] = []
    for i, (x, y) in enumerate(places):
        while len(kept) > 1:
            (ax, ay), (bx, by) = places[kept[-2]], places[kept[-1]]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                break
            kept.pop()
        kept.append(i)
    return np.array(kept)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def is_end_in_view(image: RangeImage, sweep: Scan3D, target: Scan3D, config: TargetConfig) -> bool:
    """Return whether the target's right end is a silhouette: only farther things follow it.

    Args:
        image: The range image.
        sweep: All its points except the floor.
        target: The target's points among them.
        config: Its ``cluster_gap`` must be clear beyond the end, within its ``window``.
    """
    # Require a view beyond the end
    last = int(target.occupied_lines[-1])
    end = target.points[target.lines == last, :2]
    distance = float(np.median(np.hypot(end[:, 0], end[:, 1])))
    yaws = image.yaws[:, image.spec.n_beams // 2]
    clear_until = yaws[last] - config.cluster_gap / distance
    if yaws[-1] > clear_until:
        return False

    # Require that nothing beyond is nearer
    beyond = (sweep.lines > last) & (yaws[sweep.lines] > clear_until)
    beyond &= np.abs(image.elevations_at(sweep.lines, sweep.beams)) <= config.window / 2
    nearest = np.hypot(sweep.points[beyond, 0], sweep.points[beyond, 1])
    return bool(np.all(nearest > distance))


@dataclass(frozen=True)
class Segment:
    """The next segment of surface to scan.

    Attributes:
        middle: Its middle point (2,) [m].
        normal: Outward unit normal (2,).
    """

    middle: FloatArray
    normal: FloatArray

    def viewpoint(self, standoff: float, turn: float = 0.0) -> Pose2:
        """Return the pose facing its middle from ``standoff`` [m], ``turn`` [rad] off normal."""
        c, s = math.cos(turn), math.sin(turn)
        (x, y), (u, v) = self.middle.tolist(), self.normal.tolist()
        u, v = c * u - s * v, s * u + c * v
        return Pose2(x + standoff * u, y + standoff * v, math.atan2(-v, -u))


def find_predicted_segment(contour: Contour, n_Q: int, S1: float, following: FloatArray) -> Segment:
    """Return the next segment on a predicted surface: it begins where Q begins.

    Args:
        contour: Contour of the current target scan P.
        n_Q: Number of overlapping lines.
        S1: Width of the segment that a sweep covers [m].
        following: Predicted points (m, 2) after the contour's last one [m].
    """
    # Join Q and the predicted surface
    first = len(contour.points) - n_Q
    points = np.concatenate([contour.points[first:], following])
    steps = np.diff(points, axis=0)
    arc = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
    whole = Contour(points, arc)

    # Take the normal over its width
    last = int(np.searchsorted(arc, S1, side="right")) - 1
    known = contour.normal(first)
    normal = limit_direction(whole.normal(0, last), known, MAX_INCIDENCE)
    return Segment(_point_along(whole, 0, -rotate_clockwise(whole.normal(0)), S1 / 2), normal)


def find_next_segment(
    contour: Contour,
    n_Q: int,
    S1: float,
    beyond: FloatArray | None,
    *,
    ends: bool,
    bend: float = SILHOUETTE_TURN,
) -> Segment:
    """Return the segment that begins where Q begins and is as wide as S1 (Fig. 8).

    Its outward normal is the mean over the segment: that of Q on the known part and the expected
    one beyond. Where the target ``ends``, its surface turns away out of sight, and the view turns
    by the hidden part's share of the expected ``bend``.

    Args:
        contour: Contour of the current target scan P.
        n_Q: Number of overlapping lines.
        S1: Width of the segment that a sweep covers [m]; at most that of a target that ends.
        beyond: Outward unit normal expected beyond the end (2,); None for that of Q.
        ends: Whether the target ends at the last line, so that what follows is hidden.
        bend: Angle by which the surface bends over the next width where the target ends [rad].
    """
    # Measure the known share of the segment
    first = len(contour.points) - n_Q
    width = min(contour.width, S1) if ends else S1
    known = min(1.0, (contour.width - float(contour.arc[first])) / max(width, 1e-9))
    normal_known = contour.normal(first)

    # Expect the normal of the rest
    if ends:
        turn = Pose2(0.0, 0.0, (1.0 - known) * bend)
        normal, onwards = turn.rotate(TOWARDS_ROBOT), -normal_known
    else:
        expected = normal_known if beyond is None else beyond
        normal = _unit(known * normal_known + (1.0 - known) * expected)
        onwards = -rotate_clockwise(expected)
    middle = _point_along(contour, first, onwards, width / 2)
    return Segment(middle, limit_direction(normal, normal_known, MAX_INCIDENCE))


def estimate_corner_angle(contour: Contour) -> float:
    """Return the angle [rad] by which the surface is expected to bend over the contour's width.

    A curved contour goes on as curved as it is; a straight one turns by a right angle.
    """
    middle = int(np.searchsorted(contour.arc, contour.width / 2))
    bend = measure_angle(contour.normal(0, middle), contour.normal(middle))
    return min(2 * bend, SILHOUETTE_TURN) if bend > STRAIGHT_ANGLE else SILHOUETTE_TURN


def find_first_segment(contour: Contour, width: float, *, from_left: bool) -> Segment:
    """Return the segment to start with.

    Args:
        contour: Contour of the target in the panorama.
        width: Length of surface that one sweep covers [m].
        from_left: Whether to begin at the target's left end, seen from ``MAX_FRONT_ANGLE``; else
            with its middle, from the side on which the robot is.
    """
    if from_left:
        last = int(np.searchsorted(contour.arc, width, side="right")) - 1
        corner = Pose2(0.0, 0.0, -MAX_FRONT_ANGLE).rotate(contour.normal(0, last))
        return Segment(contour.points[0], corner)
    middle = _point_along(contour, 0, np.zeros(2), contour.width / 2)
    return Segment(middle, -_unit(middle))


def measure_sweep_width(config: Config) -> float:
    """Return the width of surface that a sweep covers from the standoff [m]."""
    half = min(config.sweep.width, math.pi / 2) / 2
    return 2 * config.planning.standoff * math.tan(half)


def extract_panorama_contour(points: FloatArray) -> Contour:
    """Return the contour of a coarse top view (n, 2) [m] around the robot at the origin."""
    return trace_contour(_average_bearings(points))


def _average_bearings(points: FloatArray) -> FloatArray:
    """Return the mean point of each bearing of a coarse top view, from left to right."""
    bearings = np.arctan2(points[:, 1], points[:, 0])
    middle = math.atan2(float(np.sin(bearings).mean()), float(np.cos(bearings).mean()))
    bearings = (bearings - middle + np.pi) % (2 * np.pi)
    order = np.argsort(-bearings, kind="stable")
    groups = np.cumsum(np.diff(-bearings[order], prepend=-bearings[order[0]]) > np.radians(1.0))
    count = np.bincount(groups)
    return np.stack([np.bincount(groups, points[order, i]) / count for i in (0, 1)], axis=1)


def iterate_alternatives(segment: Segment, config: Config) -> Iterator[Pose2]:
    """Yield viewpoints for ``segment``: the wanted one, then nearer, farther and rotated ones."""
    for turn, factor in _ALTERNATIVES:
        yield segment.viewpoint(factor * config.planning.standoff, math.radians(turn))


def iterate_oblique(segment: Segment, standoff: float) -> Iterator[Pose2]:
    """Yield viewpoints for ``segment`` from ``standoff`` [m] that are turned off its normal.

    None of them is nearer: from there less is seen, and ever shorter steps get nowhere.
    """
    for turn in _OBLIQUE_TURNS:
        yield segment.viewpoint(standoff, turn)


def choose_viewpoint(
    segment: Segment, config: Config, feasible: Callable[[Pose2], bool]
) -> tuple[Pose2 | None, bool]:
    """Return the first feasible viewpoint for ``segment`` and whether it is the wanted one."""
    for k, viewpoint in enumerate(iterate_alternatives(segment, config)):
        if feasible(viewpoint):
            return viewpoint, k == 0
    return None, False


def _point_along(contour: Contour, first: int, onwards: FloatArray, length: float) -> FloatArray:
    """Return the point ``length`` [m] after line ``first``; beyond the end, along ``onwards``."""
    wanted = float(contour.arc[first]) + length
    if wanted > contour.width:
        return np.asarray(contour.points[-1] + (wanted - contour.width) * onwards)
    return np.array([np.interp(wanted, contour.arc, contour.points[:, i]) for i in (0, 1)])


def sum_turns(poses: Iterable[Pose2]) -> float:
    """Return the sum of the turns from each of ``poses`` to the next [rad], left positive."""
    return sum(wrap(b.yaw - a.yaw) for a, b in pairwise(poses))


def measure_angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle from ``a`` (2,) to ``b`` (2,), counter-clockwise [rad]."""
    (ax, ay), (bx, by) = a.tolist(), b.tolist()
    return math.atan2(ax * by - ay * bx, float(a @ b))


def limit_direction(normal: FloatArray, reference: FloatArray, most: float) -> FloatArray:
    """Return ``normal``, rotated towards ``reference`` until within ``most`` [rad] of it."""
    angle = measure_angle(reference, normal)
    if abs(angle) <= most:
        return normal
    return Pose2(0.0, 0.0, math.copysign(most, angle)).apply(reference)


def rotate_clockwise(vector: FloatArray) -> FloatArray:
    """Return ``vector`` (2,), rotated a quarter turn clockwise.

    For a robot that faces a surface, this makes the outward normal of the direction along the
    surface to the right.
    """
    return np.array([vector[1], -vector[0]])


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / max(math.sqrt(float(vector @ vector)), 1e-12))
