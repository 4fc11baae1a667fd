"""Point clouds of simulated rooms, objects and degenerate scenes, by ray casting in closed form.

Scenes consist of boxes, vertical cylinders, spheres and rectangles. Sensors are a vertical lidar
that is turned (a grid of lines and beams), a spinning lidar of 16 to 64 beams whose mount may be
tilted, a solid-state lidar with random directions, and points spread uniformly over all surfaces,
as of a sampled mesh. Points come in random order, in the sensor's frame, with noise along the ray
and mixed pixels where a ray grazes an edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

from scan3d_twin.core.registration.pose_prior import deviation, shift_to_target
from scan3d_twin.core.types import FloatArray, RegistrationResult

MIXED_SHARE = 0.5
"""Share of the rays closer than half a beam to a depth edge that return a range in between."""


@dataclass(frozen=True)
class Body:
    """A solid or a rectangle.

    Attributes:
        kind: ``box``, ``cylinder`` (vertical), ``sphere`` or ``sheet`` (a horizontal rectangle).
        centre: Centre (3,) [m].
        size: Half extents (3,) [m]; of a cylinder radius, radius and half height, of a sphere its
            radius thrice.
        yaw: Rotation about z [rad].
    """

    kind: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Bodies and the places to scan them from.

    Attributes:
        bodies: What is there.
        viewpoint: Where a sensor stands (3,) [m].
    """

    bodies: tuple[Body, ...]
    viewpoint: tuple[float, float, float] = (0.0, 0.0, 0.5)


@dataclass(frozen=True)
class Sensor:
    """A range sensor.

    Attributes:
        kind: ``sweep``, ``spinning``, ``random`` or ``uniform``.
        points: Approximate number of directions, or of points of ``uniform``.
        sigma: Standard deviation of ranges [m]; of ``uniform`` in every direction.
        width: Horizontal field of view [rad].
        height: Vertical field of view [rad].
        beams: Number of beams of ``spinning``.
        tilt: Tilt of the mount about y [rad]; points are given in the levelled frame.
        reach: Longest range [m].
    """

    kind: str
    points: int
    sigma: float
    width: float = math.tau
    height: float = math.radians(75.0)
    beams: int = 16
    tilt: float = 0.0
    reach: float = 30.0


def rotation(axis: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(axis))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = axis / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K)


def transform(place: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the pose (4, 4) at ``place`` (3,) [m] turned by a rotation vector (3,) [rad]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(np.asarray(axis, dtype=np.float64)), place
    return T


# --- rays ---


def cast(bodies: tuple[Body, ...], origin: FloatArray, rays: FloatArray) -> FloatArray:
    """Return the ranges (n,) [m] along ``rays`` (n, 3) from ``origin`` (3,); inf without a hit."""
    ranges = np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for body in bodies:
            R = rotation(np.array([0.0, 0.0, -body.yaw]))
            o, d = R @ (origin - body.centre), rays @ R.T
            hit = _HITS[body.kind](o, d, np.array(body.size))
            ranges = np.minimum(ranges, np.where(hit > 1e-6, hit, np.inf))
    return ranges


def _hit_box(o: FloatArray, d: FloatArray, size: FloatArray) -> FloatArray:
    """Return the range to a box; from inside to its walls."""
    a, b = (-size - o) / d, (size - o) / d
    enter, leave = np.nanmax(np.minimum(a, b), axis=1), np.nanmin(np.maximum(a, b), axis=1)
    return np.where(enter <= leave, np.where(enter > 0, enter, leave), np.inf)


def _hit_sheet(o: FloatArray, d: FloatArray, size: FloatArray) -> FloatArray:
    t = -o[2] / d[:, 2]
    x = o + t[:, None] * d
    return np.where((np.abs(x[:, 0]) < size[0]) & (np.abs(x[:, 1]) < size[1]), t, np.inf)


def _hit_sphere(o: FloatArray, d: FloatArray, size: FloatArray) -> FloatArray:
    middle, rest = d @ o, o @ o - size[0] ** 2
    root = np.sqrt(middle**2 - rest)
    return np.where(root >= 0, -middle - root, np.inf)


def _hit_cylinder(o: FloatArray, d: FloatArray, size: FloatArray) -> FloatArray:
    flat = d[:, 0] ** 2 + d[:, 1] ** 2
    middle, rest = d[:, :2] @ o[:2], o[:2] @ o[:2] - size[0] ** 2
    t = (-middle - np.sqrt(middle**2 - flat * rest)) / flat
    side = np.where(np.abs(o[2] + t * d[:, 2]) < size[2], t, np.inf)
    top = (size[2] - o[2]) / d[:, 2]
    x = o[:2] + top[:, None] * d[:, :2]
    lid = np.where(np.sum(x**2, axis=1) < size[0] ** 2, top, np.inf)
    side[~(side > 0)], lid[~(lid > 0)] = np.inf, np.inf
    return np.minimum(side, lid)


_HITS = {
    "box": _hit_box,
    "sheet": _hit_sheet,
    "sphere": _hit_sphere,
    "cylinder": _hit_cylinder,
}


# --- sensors ---


def _directions(sensor: Sensor, rng: np.random.Generator) -> FloatArray:
    """Return unit vectors (n, 3) in the sensor's frame."""
    half = sensor.width / 2
    if sensor.kind == "spinning":
        lines = max(8, sensor.points // sensor.beams)
        yaw = (np.arange(lines) + rng.random()) / lines * sensor.width - half
        up = np.linspace(-0.5, 0.5, sensor.beams) * min(sensor.height, math.radians(40.0))
        yaw, up = np.repeat(yaw, sensor.beams), np.tile(up, lines)
    elif sensor.kind == "sweep":
        step = math.sqrt(sensor.width * sensor.height / sensor.points)
        yaws = np.arange(-half, half, 1.4 * step) + step * rng.random()
        ups = np.arange(-sensor.height / 2, sensor.height / 2, step / 1.4)
        yaw, up = np.repeat(yaws, len(ups)), np.tile(ups, len(yaws))
    else:
        yaw = rng.uniform(-half, half, sensor.points)
        up = rng.uniform(-0.5, 0.5, sensor.points) * sensor.height
    rays = np.stack([np.cos(up) * np.cos(yaw), np.cos(up) * np.sin(yaw), np.sin(up)], axis=1)
    return np.asarray(rays @ rotation(np.array([0.0, sensor.tilt, 0.0])).T)


def scan(scene: Scene, sensor: Sensor, pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the points (n, 3) [m] that ``sensor`` measures at ``pose`` (4, 4), in its frame."""
    R, t = pose[:3, :3], pose[:3, 3]
    if sensor.kind == "uniform":
        points = _spread(scene.bodies, sensor.points, rng)
        points = points + sensor.sigma * rng.standard_normal(points.shape)
        near = np.linalg.norm(points - t, axis=1) < sensor.reach
        return np.asarray((points[near] - t) @ R)
    rays = _directions(sensor, rng)
    ranges = cast(scene.bodies, t, rays @ R.T)

    # Mixed pixels: a beam of finite width sees two depths.
    spread = 0.25 * math.sqrt(sensor.width * sensor.height / sensor.points)
    beside = cast(scene.bodies, t, (rays + spread * rng.standard_normal(rays.shape)) @ R.T)
    with np.errstate(invalid="ignore"):
        beside = np.where(np.isfinite(beside), beside, ranges) - ranges
    edge = np.abs(beside) > 0.1 * ranges
    mixed = edge & (rng.random(len(ranges)) < MIXED_SHARE) & np.isfinite(ranges)
    share = rng.random(len(ranges))
    ranges = np.where(mixed, ranges + share * np.where(mixed, beside, 0.0), ranges)

    # Noise along the ray.
    ranges = ranges + sensor.sigma * rng.standard_normal(len(ranges))
    kept = (ranges < sensor.reach) & (ranges > 0.05)
    points = rays[kept] * ranges[kept, None]
    return np.asarray(points[rng.permutation(len(points))])


def _spread(bodies: tuple[Body, ...], n: int, rng: np.random.Generator) -> FloatArray:
    """Return ``n`` points (n, 3) spread uniformly over the surfaces of all bodies."""
    areas = np.array([_area(body) for body in bodies])
    counts = rng.multinomial(n, areas / areas.sum())
    parts = []
    for body, count in zip(bodies, counts, strict=True):
        size = np.array(body.size)
        if body.kind == "sphere":
            u = rng.standard_normal((count, 3))
            local = size[0] * u / np.linalg.norm(u, axis=1, keepdims=True)
        elif body.kind == "cylinder":
            angle = rng.uniform(0, math.tau, count)
            local = np.stack(
                [size[0] * np.cos(angle), size[0] * np.sin(angle),
                 size[2] * rng.uniform(-1, 1, count)], axis=1,
            )  # fmt: skip
        else:
            local = rng.uniform(-1, 1, (count, 3)) * size
            faces = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
            axis = rng.choice(3, count, p=faces / faces.sum())
            at = np.arange(count)
            local[at, axis] = np.where(rng.random(count) < 0.5, -1, 1) * size[axis]
        parts.append(local @ rotation(np.array([0.0, 0.0, body.yaw])).T + body.centre)
    return np.concatenate(parts)


def _area(body: Body) -> float:
    x, y, z = body.size
    if body.kind == "sphere":
        return 4 * math.pi * x * x
    if body.kind == "cylinder":
        return 4 * math.pi * x * z
    return 8 * (x * y + y * z + z * x)


def overlap(scene: Scene, sensor: Sensor, source: FloatArray, pose: FloatArray) -> float:
    """Return the share of points ``source`` (n, 3) [m, world] that ``sensor`` at ``pose`` sees."""
    if sensor.kind == "uniform":
        return float(np.mean(np.linalg.norm(source - pose[:3, 3], axis=1) < sensor.reach))
    rays = source - pose[:3, 3]
    distance = np.linalg.norm(rays, axis=1)
    rays = rays / distance[:, None]
    seen = cast(scene.bodies, pose[:3, 3], rays) > distance - 0.05 - 6 * sensor.sigma
    local = rays @ pose[:3, :3] @ rotation(np.array([0.0, sensor.tilt, 0.0]))
    yaw, up = np.arctan2(local[:, 1], local[:, 0]), np.arcsin(np.clip(local[:, 2], -1, 1))
    high = min(sensor.height, math.radians(40.0)) if sensor.kind == "spinning" else sensor.height
    inside = (np.abs(yaw) <= sensor.width / 2) & (np.abs(up) <= high / 2)
    return float(np.mean(seen & inside & (distance < sensor.reach)))


# --- random pairs ---


@dataclass(frozen=True)
class CloudPair:
    """Two clouds.

    Attributes:
        target: Points (n, 3) [m] in the frame of the first pose.
        source: Points (m, 3) [m] in the frame of the second pose.
        truth: ``T_target_source`` (4, 4).
        init: The guess (4, 4).
        sensor: What measured them.
        dof: ``planar`` where the truth and the guess differ by x, y and yaw only, else ``se3``.
        overlap: Share of the source that the target's sensor sees, 0..1.
    """

    target: FloatArray
    source: FloatArray
    truth: FloatArray
    init: FloatArray
    sensor: Sensor
    dof: str
    overlap: float = field(default=1.0)


def random_scene(rng: np.random.Generator) -> Scene:
    """Return a room with furniture, or objects on an open floor."""
    room = bool(rng.random() < 0.7)
    x, y, z = rng.uniform(1.5, 4.0), rng.uniform(1.5, 4.0), rng.uniform(1.2, 1.6)
    bodies = [Body("box", (0.0, 0.0, z), (x, y, z))] if room else [
        Body("sheet", (0.0, 0.0, 0.0), (6.0, 6.0, 0.0))
    ]  # fmt: skip
    count = int(rng.integers(3, 10)) if room else int(rng.integers(4, 9))
    for _ in range(count):
        kind = str(rng.choice(["box", "box", "box", "cylinder", "sphere"]))
        size = rng.uniform(0.1, 0.6, 3)
        if kind != "box":
            size[:2] = rng.uniform(0.1, 0.5)
        if kind == "sphere":
            size[2] = size[0]
        angle, far = rng.uniform(0, math.tau), rng.uniform(1.0, 1.0 + (max(x, y) - 1.0))
        place = np.array([far * math.cos(angle), far * math.sin(angle)])
        if room:
            place = np.clip(place, [-x + 0.2, -y + 0.2], [x - 0.2, y - 0.2])
        if np.linalg.norm(place) < 0.9 + np.linalg.norm(size[:2]):
            continue
        bodies.append(
            Body(kind, (float(place[0]), float(place[1]), float(size[2])),
                 tuple(map(float, size)), rng.uniform(0, math.pi))  # type: ignore[arg-type]
        )  # fmt: skip
    return Scene(tuple(bodies), (0.0, 0.0, rng.uniform(0.3, 0.9)))


def random_sensor(rng: np.random.Generator) -> Sensor:
    """Return one of the four kinds of sensors, with 2000 to 40 000 points and 1 to 15 mm noise."""
    kind = str(rng.choice(["sweep", "spinning", "random", "uniform"]))
    points = int(2000 * 20 ** rng.random())
    sigma = 0.001 * 15 ** rng.random()
    width = math.tau if kind == "spinning" else float(rng.choice([math.tau, math.radians(150.0)]))
    tilt = float(rng.choice([0.0, rng.uniform(-0.35, 0.35)])) if kind == "spinning" else 0.0
    beams = int(rng.choice([16, 32, 64]))
    points = max(points, 600 * beams) if kind == "spinning" else points
    return Sensor(kind, points, sigma, width, beams=beams, tilt=tilt)


def random_pair(
    seed: int,
    offset: float = 0.5,
    turn: float = math.radians(10.0),
    dof: str | None = None,
    apart: float = 0.7,
) -> CloudPair:
    """Return a pair with at least half its source seen from both sides.

    The guess is up to ``offset`` [m] and ``turn`` [rad] off.
    """
    rng = np.random.default_rng([seed, 16])
    while True:
        scene, sensor = random_scene(rng), random_sensor(rng)
        free = (str(rng.choice(["planar", "se3"])) if dof is None else dof) == "se3"
        z = scene.viewpoint[2]
        first = transform(np.array([0.0, 0.0, z]), [0, 0, rng.uniform(-math.pi, math.pi)])
        angle, far = rng.uniform(0, math.tau), rng.uniform(0.0, apart)
        place = np.array([far * math.cos(angle), far * math.sin(angle), z])
        axis = np.array([0.0, 0.0, rng.uniform(-0.9, 0.9) * apart])
        if free:
            place[2] += rng.uniform(-0.1, 0.1)
            axis[:2] = rng.uniform(-0.1, 0.1, 2)
        second = first @ transform(place - [0.0, 0.0, z], axis)
        target, source = (scan(scene, sensor, pose, rng) for pose in (first, second))
        if min(_count_off_floor(c, T) for c, T in ((target, first), (source, second))) < 500:
            continue
        seen = overlap(scene, sensor, source @ second[:3, :3].T + second[:3, 3], first)
        if seen < 0.5:
            continue
        truth = np.linalg.inv(first) @ second
        init = displace_randomly(truth, offset, turn, free, rng)
        return CloudPair(target, source, truth, init, sensor, "se3" if free else "planar", seen)


def _count_off_floor(points: FloatArray, pose: FloatArray) -> float:
    """Return the number of points (n, 3) off the floor; 0 if three quarters are on it.

    A floor says nothing about x, y and yaw; 0.05 m is three times the largest noise.
    """
    off = np.count_nonzero(points @ pose[2, :3] + pose[2, 3] > 0.05)
    return float(off) if off > 0.25 * len(points) else 0.0


def displace_randomly(
    T: FloatArray, offset: float, turn: float, free: bool, rng: np.random.Generator
) -> FloatArray:
    """Return ``T`` (4, 4) shifted by up to ``offset`` [m] and turned by up to ``turn`` [rad]."""
    shift, axis = rng.standard_normal(3), rng.standard_normal(3)
    if not free:
        shift[2], axis[:2] = 0.0, 0.0
    moved = T.copy()
    moved[:3, 3] += offset * rng.random() * shift / np.linalg.norm(shift)
    moved[:3, :3] = rotation(turn * rng.random() * axis / np.linalg.norm(axis)) @ T[:3, :3]
    return moved


def point_error(points: FloatArray, estimate: FloatArray, truth: FloatArray) -> float:
    """Return the RMS [m] over ``points`` (n, 3) of the distance that two poses place them apart."""
    off = points @ (estimate - truth)[:3, :3].T + (estimate - truth)[:3, 3]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


# --- degenerate cases ---


@dataclass(frozen=True)
class DegenerateCase:
    """A scene that does not determine the pose.

    Attributes:
        bodies: What there is.
        slides: Directions in the world along which it can be shifted into itself (k, 3).
        turns: Axes about which it can be turned into itself: a point and a direction (m, 2, 3).
    """

    bodies: tuple[Body, ...]
    slides: tuple[tuple[float, float, float], ...] = ()
    turns: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()

    def directions(self, target: FloatArray, dof: str) -> FloatArray:
        """Return the undetermined directions (k, 6) about the origin of ``target`` (4, 4)."""
        R, t = target[:3, :3], target[:3, 3]
        rows = [np.concatenate([R.T @ slide, np.zeros(3)]) for slide in self.slides]
        for centre, axis in self.turns:
            c, w = R.T @ (np.array(centre) - t), R.T @ np.array(axis)
            rows.append(np.concatenate([np.cross(c, w), w]))
        every = np.array(rows).reshape(-1, 6)
        if dof == "se3" or len(every) == 0:
            return every

        # Combinations that keep z, rx and ry.
        left = np.linalg.svd(every[:, [2, 3, 4]].T)
        rank = int(np.count_nonzero(left[1] > 1e-9))
        return np.asarray(left[2][rank:] @ every)


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_FLOOR = Body("sheet", (0.0, 0.0, 0.0), (40.0, 40.0, 0.0))
_WALL = Body("box", (2.0, 0.0, 0.0), (0.1, 40.0, 40.0))
_BACK = Body("box", (-1.0, 0.0, 0.0), (0.1, 40.0, 40.0))
_END = Body("box", (0.0, 2.5, 0.0), (40.0, 0.1, 40.0))
_ABOUT_X = ((2.0, 0.0, 0.0), _X)
_BALL = (2.0, 0.0, 0.6)
_PILLARS = tuple(Body("cylinder", (1.8, 0.6 * k, 0.0), (0.1, 0.1, 40.0)) for k in range(-60, 61))

DEGENERATE = {
    "floor": DegenerateCase((_FLOOR,), (_X, _Y), (((0.0, 0.0, 0.0), _Z),)),
    "two planes": DegenerateCase((_WALL, _END), (_Z,)),
    "floor and wall": DegenerateCase((_FLOOR, _WALL), (_Y,)),
    "corridor": DegenerateCase((_WALL, _BACK), (_Y, _Z), (_ABOUT_X,)),
    "corridor with floor": DegenerateCase((_FLOOR, _WALL, _BACK), (_Y,)),
    "sphere": DegenerateCase(
        (Body("sphere", _BALL, (0.5, 0.5, 0.5)),), (), tuple((_BALL, axis) for axis in (_X, _Y, _Z))
    ),
    "cylinder": DegenerateCase(
        (Body("cylinder", (2.0, 0.0, 0.0), (0.4, 0.4, 40.0)),), (_Z,), (((2.0, 0.0, 0.0), _Z),)
    ),
    "pillars": DegenerateCase((_FLOOR, _WALL, *_PILLARS)),
}
"""Scenes and what leaves them as they are; pillars repeat every 0.6 m and are only ambiguous."""


def degenerate_pair(
    name: str, seed: int, dof: str, offset: float = 0.05, turn: float = math.radians(3.0)
) -> tuple[CloudPair, FloatArray]:
    """Return a pair of a degenerate scene, and its undetermined directions (k, 6).

    ``disjoint`` has no common surface; ``identical`` is the same cloud of a room twice.
    """
    rng = np.random.default_rng([seed, 17])
    width = math.tau if "corridor" in name else math.radians(150.0)
    sensor = Sensor("random", 6000, 0.005, width, math.radians(75.0), reach=6.0)
    first = transform(np.array([0.0, 0.0, 0.6]), [0.0, 0.0, rng.uniform(-0.2, 0.2)])
    place = [rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.3), rng.uniform(-0.1, 0.1)]
    axis = [*rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.15, 0.15)]
    if dof == "planar":
        place[2], axis[0], axis[1] = 0.0, 0.0, 0.0
    step = transform(np.array(place), np.array(axis))
    case = DEGENERATE.get(name, DegenerateCase(random_scene(rng).bodies))
    if name == "disjoint":
        step = transform(np.array([0.0, 0.0, 0.0]), [0.0, 0.0, math.pi])
    second = first @ step
    scene = Scene(case.bodies)
    target = scan(scene, sensor, first, rng)
    source = target.copy() if name == "identical" else scan(scene, sensor, second, rng)
    truth = np.eye(4) if name == "identical" else np.linalg.inv(first) @ second
    init = displace_randomly(truth, offset, turn, dof == "se3", rng)
    if name == "disjoint":
        init = displace_randomly(np.eye(4), offset, turn, dof == "se3", rng)
    return CloudPair(target, source, truth, init, sensor, dof), case.directions(first, dof)


def nearest_equivalent(
    truth: FloatArray, estimate: FloatArray, directions: FloatArray, reach: float
) -> FloatArray:
    """Return the pose (4, 4) nearest to ``estimate`` that a scene tells as little from ``truth``.

    ``truth`` is moved by the one-parameter groups of ``directions`` (k, 6), not along straight
    lines: a turn of 2 deg about an axis 2 m off leaves the tangent by 1 mm.
    """
    unit = np.array([1.0, 1.0, 1.0, reach, reach, reach])
    pose = truth
    for _ in range(20):
        off = shift_to_target(pose) @ deviation(estimate, pose)
        along = np.linalg.lstsq((directions * unit).T, off * unit, rcond=None)[0] @ directions
        twist = np.zeros((4, 4))
        twist[:3, :3] = np.cross(np.eye(3), along[3:])
        twist[:3, 3] = along[:3]
        pose = expm(twist) @ pose
    return np.asarray(pose)


def compare_determined(
    result: RegistrationResult,
    truth: FloatArray,
    directions: FloatArray,
    points: FloatArray,
    dims: tuple[int, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return errors [m] and variances [m2] of the determined directions (k,) each.

    Args:
        result: Of a pair whose scene leaves some directions undetermined.
        truth: ``T_target_source`` (4, 4).
        directions: The undetermined ones about the target's origin (j, 6).
        points: Points of the source (n, 3) [m], whose RMS distance scales rotations.
        dims: The estimated entries of x y z rx ry rz.
    """
    reach = math.sqrt(float(np.mean(np.sum(points**2, axis=1))))
    unit, rows = np.repeat([1.0, 1.0 / reach], 3), list(dims)
    basis = np.linalg.svd((directions / unit)[:, rows])[2][len(directions) :]
    found = result.T_target_source
    nearest = nearest_equivalent(truth, found, directions, reach)
    off = shift_to_target(nearest) @ deviation(found, nearest)
    scaled = (result.information * np.outer(unit, unit))[np.ix_(rows, rows)]
    covariance = np.linalg.pinv(scaled, rcond=1e-9, hermitian=True)
    return basis @ (off / unit)[rows], np.diagonal(basis @ covariance @ basis.T)


def spans_agree(found: FloatArray, expected: FloatArray, reach: float) -> bool:
    """Return whether two sets of directions (k, 6) span the same space to within 10 deg."""
    if len(found) != len(expected):
        return False
    if len(found) == 0:
        return True
    unit = np.array([1.0, 1.0, 1.0, reach, reach, reach])
    a, b = (np.linalg.qr((each * unit).T)[0] for each in (found, expected))
    return bool(np.linalg.svd(a.T @ b)[1].min() > math.cos(math.radians(10.0)))
