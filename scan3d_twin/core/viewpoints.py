"""Geometry of viewpoints (paper Fig. 8): the target's contour, and where to stand next.

All in the top view of frame ``scan``, left to right as the robot sees it; the robot travels to the
right, so counter-clockwise around the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.types import FloatArray, IntArray, Pose2, RangeImage, Scan3D

MAX_INCIDENCE = math.radians(65.0)
"""Q is seen from O2 at no flatter angle than this from its mean normal; beyond about 70 deg the
URG-04LX returns gross errors (UBG-04LX-F01 data, 80 deg)."""
REACH = 6
"""Lines over which the direction of the surface is taken at the contour's end."""
CORNER = math.radians(30.0)
"""A surface that bends by more than this has turned a corner."""
STRAIGHT = math.radians(5.0)
"""A contour whose two halves differ by less than this is straight: noise alone makes 1 or 2 deg."""
BEND = math.radians(90.0)
"""By how much a surface that ends in view turns out of sight: it ends as a silhouette, whether at
an edge, behind which faces mostly stand at right angles, or along a curve."""
FRONT_SIDE = math.radians(45.0)
"""A tour of the front looks at it from no more than this to either side."""
_ALTERNATIVES = tuple(
    (turn, factor)
    for _, turn, factor in sorted(
        (abs(turn) / 30.0 + abs(factor - 1.0) / 0.3, turn, factor)
        for turn in (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
        for factor in (1.0, 0.85, 1.15, 0.7, 1.3, 0.55)
    )
)
"""Turns [deg] off a segment's normal and shares of the standoff, the least change first."""
HERE = np.array([-1.0, 0.0])
"""Direction from what the robot looks at towards the robot, in ``scan``."""


@dataclass(frozen=True)
class Contour:
    """Convex top-view envelope of a target towards the robot, one point per line, left to right.

    Gaps and niches do not count: the robot travels along the envelope, not into them.

    Attributes:
        points: Where each line meets the envelope (n, 2) [m].
        arc: Length along the envelope from the first point (n,) [m].
    """

    points: FloatArray
    arc: FloatArray

    @property
    def width(self) -> float:
        """Length of the whole segment [m]: the paper's S1."""
        return float(self.arc[-1])

    def normal(self, first: int, last: int = -1) -> FloatArray:
        """Return the mean outward unit normal (2,) between two points: that of their chord."""
        chord = self.points[last] - self.points[first]
        return _unit(clockwise(chord)) if chord.any() else -_unit(self.points[first])


def well_seen(contour: Contour) -> int:
    """Return how many lines, from the left, lie before the surface turns too flat on the right.

    Lines at grazing incidence are few, noisy and far apart: a poor basis for an overlap.
    """
    n = len(contour.points)
    for k in range(n, 1, -1):
        normal = contour.normal(max(0, k - REACH), k - 1)
        if angle_between(normal, -contour.points[k - 1]) > -MAX_INCIDENCE:
            return k
    return n


def bends_after(contour: Contour, k: int) -> bool:
    """Tell whether the surface after the first ``k`` lines turns away from them."""
    if k >= len(contour.points):
        return False
    return angle_between(contour.normal(0, k - 1), contour.normal(k)) > CORNER


def contour_of(scan: Scan3D) -> Contour:
    """Return the contour of a target scan, from the mean top-view point of each of its lines."""
    return trace(line_means(scan))


def line_means(scan: Scan3D) -> FloatArray:
    """Return the mean top-view point (n, 2) of each occupied line [m]."""
    count = np.bincount(scan.lines, minlength=scan.n_lines)
    sums = [np.bincount(scan.lines, scan.points[:, i], scan.n_lines) for i in (0, 1)]
    lines = np.flatnonzero(count)
    return np.stack([total[lines] / count[lines] for total in sums], axis=1)


def trace(points: FloatArray) -> Contour:
    """Return the contour of ``points`` (n, 2), given left to right around the origin."""
    kept = _convex_towards_origin(points)
    edge = np.clip(np.searchsorted(kept, np.arange(len(points)), side="right") - 1, 0, None)
    a = points[kept[np.minimum(edge, len(kept) - 1)]]
    b = points[kept[np.minimum(edge + 1, len(kept) - 1)]]
    across = _cross(b - a, points)
    share = np.divide(_cross(points, a), across, out=np.zeros(len(points)), where=across != 0)
    envelope = a + np.clip(share, 0.0, 1.0)[:, None] * (b - a)
    steps = np.diff(envelope, axis=0)
    return Contour(envelope, np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))))


def _convex_towards_origin(points: FloatArray) -> IntArray:
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


def ends_in_view(image: RangeImage, sweep: Scan3D, target: Scan3D, config: TargetConfig) -> bool:
    """Tell whether the target's right end is a silhouette: only farther things follow it.

    Args:
        image: The range image.
        sweep: All its points except the floor.
        target: The target's points among them.
        config: Beyond the end, ``cluster_gap`` has to be clear in the window.
    """
    last = int(target.occupied_lines[-1])
    end = target.points[target.lines == last, :2]
    distance = float(np.median(np.hypot(end[:, 0], end[:, 1])))
    yaws = image.yaws[:, image.spec.n_beams // 2]
    clear_until = yaws[last] - config.cluster_gap / distance
    if yaws[-1] > clear_until:
        return False
    beyond = (sweep.lines > last) & (yaws[sweep.lines] > clear_until)
    beyond &= np.abs(image.spec.elevations[sweep.beams]) <= config.window / 2
    nearest = np.hypot(sweep.points[beyond, 0], sweep.points[beyond, 1])
    return bool(np.all(nearest > distance))


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
        """Return the pose that faces the middle from ``standoff``, off the normal by ``turn``."""
        c, s = math.cos(turn), math.sin(turn)
        (x, y), (u, v) = self.middle.tolist(), self.normal.tolist()
        u, v = c * u - s * v, s * u + c * v
        return Pose2(x + standoff * u, y + standoff * v, math.atan2(-v, -u))


def foreseen_segment(contour: Contour, n_Q: int, S1: float, following: FloatArray) -> Segment:
    """Return the segment that begins where Q begins and lies on the surface predicted beyond it.

    Args:
        contour: Of the current target scan P.
        n_Q: Number of overlapping lines.
        S1: Width of the segment that a sweep covers [m].
        following: Predicted points (m, 2) after the contour's last one [m].
    """
    first = len(contour.points) - n_Q
    points = np.concatenate([contour.points[first:], following])
    steps = np.diff(points, axis=0)
    arc = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
    whole = Contour(points, arc)
    last = int(np.searchsorted(arc, S1, side="right")) - 1
    known = contour.normal(first)
    normal = limit(whole.normal(0, last), known, MAX_INCIDENCE)
    return Segment(_along(whole, 0, -clockwise(whole.normal(0)), S1 / 2), normal)


def next_segment(
    contour: Contour,
    n_Q: int,
    S1: float,
    beyond: FloatArray | None,
    *,
    ends: bool,
    bend: float = BEND,
) -> Segment:
    """Return the segment that begins where Q begins and is as wide as S1 (Fig. 8).

    Its outward normal is the mean over the segment: that of Q on the part that is known, and what
    is expected beyond. Where the target ``ends``, the surface goes on around it out of sight, and
    the view turns by the hidden part's share of the ``bend`` expected there.

    Args:
        contour: Of the current target scan P.
        n_Q: Number of overlapping lines.
        S1: Width of the segment that a sweep covers [m]; of a target that ends, at most its own.
        beyond: Outward unit normal expected beyond the end (2,); None to go on as Q lies.
        ends: Whether the target ends at the last line, so that what follows is hidden.
        bend: By how much the surface bends over the next width where the target ends [rad].
    """
    first = len(contour.points) - n_Q
    width = min(contour.width, S1) if ends else S1
    known = min(1.0, (contour.width - float(contour.arc[first])) / max(width, 1e-9))
    normal_known = contour.normal(first)
    if ends:
        turn = Pose2(0.0, 0.0, (1.0 - known) * bend)
        normal, onwards = turn.rotate(HERE), -normal_known
    else:
        expected = normal_known if beyond is None else beyond
        normal = _unit(known * normal_known + (1.0 - known) * expected)
        onwards = -clockwise(expected)
    middle = _along(contour, first, onwards, width / 2)
    return Segment(middle, limit(normal, normal_known, MAX_INCIDENCE))


def corner_angle(contour: Contour) -> float:
    """Return the angle [rad] by which a contour bends over its next width if it goes on as it is.

    A curved contour as curved as it is; a straight one by a right angle.
    """
    middle = int(np.searchsorted(contour.arc, contour.width / 2))
    bend = angle_between(contour.normal(0, middle), contour.normal(middle))
    return min(2 * bend, BEND) if bend > STRAIGHT else BEND


def first_segment(contour: Contour, width: float, *, from_left: bool) -> Segment:
    """Return the segment to start with.

    Args:
        contour: Of the target as the look around saw it.
        width: Length of surface that one sweep covers [m].
        from_left: Whether to begin around the target's left end, looking at it from ``FRONT_SIDE``;
            else with its middle, from the side the robot is on.
    """
    if from_left:
        last = int(np.searchsorted(contour.arc, width, side="right")) - 1
        corner = Pose2(0.0, 0.0, -FRONT_SIDE).rotate(contour.normal(0, last))
        return Segment(contour.points[0], corner)
    middle = _along(contour, 0, np.zeros(2), contour.width / 2)
    return Segment(middle, -_unit(middle))


def sweep_width(config: Config) -> float:
    """Return the width of surface that a sweep covers from the standoff [m]."""
    half = min(config.sweep.width, math.pi / 2) / 2
    return 2 * config.planning.standoff * math.tan(half)


def panorama_contour(points: FloatArray) -> Contour:
    """Return the contour of a coarse top view (n, 2) [m] around the robot at the origin."""
    return trace(_left_to_right(points))


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
    for turn, factor in _ALTERNATIVES:
        yield segment.viewpoint(factor * config.planning.standoff, math.radians(turn))


def place(
    segment: Segment, config: Config, feasible: Callable[[Pose2], bool]
) -> tuple[Pose2 | None, bool]:
    """Return the best feasible viewpoint for ``segment`` and whether it is the wanted one."""
    for k, viewpoint in enumerate(alternatives(segment, config)):
        if feasible(viewpoint):
            return viewpoint, k == 0
    return None, False


def _along(contour: Contour, first: int, onwards: FloatArray, length: float) -> FloatArray:
    """Return the point ``length`` [m] after line ``first``, ``onwards`` beyond the end."""
    wanted = float(contour.arc[first]) + length
    if wanted > contour.width:
        return np.asarray(contour.points[-1] + (wanted - contour.width) * onwards)
    return np.array([np.interp(wanted, contour.arc, contour.points[:, i]) for i in (0, 1)])


def angle_between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle from ``a`` (2,) to ``b`` (2,), counter-clockwise [rad]."""
    (ax, ay), (bx, by) = a.tolist(), b.tolist()
    return math.atan2(ax * by - ay * bx, float(a @ b))


def limit(normal: FloatArray, reference: FloatArray, most: float) -> FloatArray:
    """Return ``normal``, turned towards ``reference`` to within ``most`` [rad] of it."""
    angle = angle_between(reference, normal)
    if abs(angle) <= most:
        return normal
    return Pose2(0.0, 0.0, math.copysign(most, angle)).apply(reference)


def clockwise(vector: FloatArray) -> FloatArray:
    """Return ``vector`` turned a quarter clockwise.

    For a robot that faces a surface this turns the way along it to the right into its outward
    normal.
    """
    return np.array([vector[1], -vector[0]])


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / max(math.sqrt(float(vector @ vector)), 1e-12))
