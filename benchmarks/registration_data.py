"""Pairs of simulated sweeps for the registration benchmarks.

A vertical lidar with 213 beams of 0.3516 deg (75 deg) and a line every 0.5 deg of yaw, 5 cm ahead
of the yaw axis and 0.30 m up, ranges in whole millimetres. Scenes are polygons in the top view,
extruded to a height each, with rays cast in closed form, without a simulator. Lines and beams lie
on one grid, or as ``LINES`` says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.types import UNMEASURED, VALID, LidarSpec, Pose2, RangeImage, read_only

FloatArray = NDArray[np.float64]
BEAMS, BEAM_STEP, LINE_STEP = 213, math.tau / 1024, math.radians(0.5)
MOUNT = np.array([[1.0, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0.30], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Scene:
    """Vertical faces: segments in the top view (n, 2, 2) [m] from the floor to heights (n,) [m]."""

    segments: FloatArray
    heights: FloatArray


def box(x: float, y: float, depth: float, width: float, height: float, yaw: float) -> Scene:
    corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * [depth / 2, width / 2]
    corners = Pose2(x, y, math.radians(yaw)).apply(corners)
    return polygon(corners, height)


def polygon(corners: FloatArray, height: float) -> Scene:
    segments = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return Scene(segments, np.full(len(segments), height))


def profile(x: FloatArray, y: FloatArray, height: float) -> Scene:
    points = np.stack([x, y], axis=1)
    return Scene(np.stack([points[:-1], points[1:]], axis=1), np.full(len(x) - 1, height))


def merge(*scenes: Scene) -> Scene:
    return Scene(
        np.concatenate([s.segments for s in scenes]), np.concatenate([s.heights for s in scenes])
    )


def boxes() -> Scene:
    return merge(
        box(1.25, 0.55, 0.3, 0.40, 0.50, 0),
        box(1.15, 0.0, 0.3, 0.35, 0.40, 8),
        box(1.25, -0.55, 0.3, 0.45, 0.60, -5),
    )


def sine() -> Scene:
    y = np.linspace(0.2, -0.2, 241)
    front = 0.6 + 0.02 * np.sin(math.tau * y / 0.083)
    front[y < -0.05] = 0.6
    front[(y < -0.10) & (y > -0.14)] = 0.64
    back = np.array([[0.9, -0.2], [0.9, 0.2]])
    return polygon(np.concatenate([np.stack([front, y], axis=1), back]), 0.5)


def flatbox() -> Scene:
    return box(1.2, 0.0, 0.4, 1.0, 0.6, 0)


def wall() -> Scene:
    return profile(np.array([1.0, 1.0]), np.array([6.0, -6.0]), 0.6)


SCENES = {"boxes": boxes, "sine": sine, "flatbox": flatbox, "wall": wall}
BASELINE = {"boxes": 0.35, "sine": 0.30, "flatbox": 0.35, "wall": 0.35}
TURN = {"boxes": 8.0, "sine": 24.0, "flatbox": 8.0, "wall": 0.0}
HALF_WIDTH = {"boxes": 42.0, "sine": 28.0, "flatbox": 40.0, "wall": 40.0}


@dataclass(frozen=True)
class Noise:
    """Range sigma below 1 m (times the range beyond) [m], and yaw jitter per line [rad]."""

    sigma: float
    jitter: float = 0.0


@dataclass(frozen=True)
class Lines:
    """Where the lines and beams of a lidar lie.

    Attributes:
        interleaved: Every other line is half a beam higher.
        phase, wander, jitter: Each line begins up to half of this many beams off, with steps that
            are off by a factor of this standard deviation, and each beam by this many beams.
        uneven, lost: Standard deviation of the spacing of lines, and share of lines that are lost
            and replaced by repeated ones.
        columns: Columns of the grid for each beam of a line.
    """

    interleaved: bool = False
    phase: float = 0.0
    wander: float = 0.0
    jitter: float = 0.0
    uneven: float = 0.0
    lost: float = 0.0
    columns: int = 1

    def elevations(self, n_lines: int, rng: np.random.Generator) -> FloatArray:
        """Return the elevations of the beams (n_lines, BEAMS) [rad], ascending."""
        steps = np.arange(BEAMS) - BEAMS // 2
        shift = 0.5 * (np.arange(n_lines) % 2) if self.interleaved else np.zeros(n_lines)
        shift = shift + self.phase * rng.uniform(-0.5, 0.5, n_lines)
        scale = 1.0 + self.wander * rng.standard_normal(n_lines)
        off = self.jitter * rng.standard_normal((n_lines, BEAMS))
        return np.sort(BEAM_STEP * (scale[:, None] * steps + shift[:, None] + off), axis=1)

    def yaws(self, yaws: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the yaws of the lines (n,) [rad], falling, for evenly spaced ``yaws`` (n,)."""
        n = len(yaws)
        steps = LINE_STEP * np.maximum(0.1, 1.0 + self.uneven * rng.standard_normal(n))
        spread = yaws[0] - np.cumsum(steps) * (yaws[0] - yaws[-1]) / steps.sum()
        kept = rng.permutation(n)[round(self.lost * n) :]
        return -np.sort(-np.concatenate([spread[kept], rng.choice(spread[kept], n - len(kept))]))


LINES = {
    "regular": Lines(),
    "interleaved": Lines(interleaved=True),
    "doubled grid": Lines(interleaved=True, columns=2),
    "irregular": Lines(phase=1.0, wander=0.01, jitter=0.15),
    "uneven lines": Lines(uneven=0.15, lost=0.05),
    "all of it": Lines(phase=1.0, wander=0.01, jitter=0.15, uneven=0.15, lost=0.05),
}


def place_lines(image: RangeImage, own: FloatArray, columns: int) -> RangeImage:
    """Return ``image`` (n_lines, BEAMS), measured at elevations ``own``, on a grid."""
    steps = np.arange(columns * BEAMS) - columns * (BEAMS // 2)
    times = read_only(np.zeros(len(steps)))
    spec = replace(image.spec, elevations=read_only(steps * BEAM_STEP / columns), beam_times=times)
    rows = zip(image.stamps, own, image.ranges, image.codes, strict=True)
    lines = [
        arrange_line(spec, stamp, e, np.zeros(BEAMS), ranges, codes)
        for stamp, e, ranges, codes in rows
    ]
    codes = np.array([line.codes for line in lines])
    if columns > 1:  # as a grid that knows of no places without a beam
        codes = np.where(codes == UNMEASURED, 0, codes)
    return replace(
        image,
        yaws=read_only(np.repeat(image.yaws[:, :1], len(steps), axis=1)),
        ranges=read_only([line.ranges for line in lines]),
        codes=read_only(codes, np.int64),
        spec=spec,
        elevations=read_only([line.elevations for line in lines]),
    )


def scan(
    scene: Scene,
    pose: Pose2,
    half: float,
    noise: Noise,
    rng: np.random.Generator,
    lines: Lines = LINES["regular"],
) -> RangeImage:
    """Return the sweep of ``half`` degrees to either side seen from ``pose``; no floor."""
    elevations = (np.arange(BEAMS) - BEAMS // 2) * BEAM_STEP
    yaws = np.arange(math.radians(half), -math.radians(half) - 1e-9, -LINE_STEP)
    yaws = yaws + rng.uniform(-0.5, 0.5) * LINE_STEP
    if lines != LINES["regular"]:
        placing = np.random.default_rng([len(yaws), int(1e9 * abs(yaws[0]))])
        elevations = lines.elevations(len(yaws), placing)
        yaws = lines.yaws(yaws, placing) if lines.uneven else yaws
    true = yaws + noise.jitter * rng.standard_normal(len(yaws))
    ranges = cast(scene, pose, true, elevations)
    ranges[ranges > 4.0] = np.nan
    sigma = noise.sigma * np.maximum(1.0, ranges)
    ranges = np.round(ranges + sigma * rng.standard_normal(ranges.shape), 3)
    ranges[ranges > 4.0] = np.nan
    nominal = (np.arange(BEAMS) - BEAMS // 2) * BEAM_STEP
    spec = LidarSpec(
        read_only(nominal), read_only(np.zeros(BEAMS)), 0.1, min_range=0.02, max_range=4.0
    )
    image = RangeImage(
        read_only(0.1 * np.arange(len(yaws))),
        read_only(np.repeat(yaws[:, None], BEAMS, axis=1)),
        read_only(ranges),
        read_only(np.where(np.isfinite(ranges), VALID, 0), np.int64),
        spec,
        read_only(MOUNT),
    )
    return image if elevations.ndim == 1 else place_lines(image, elevations, lines.columns)


def cast(scene: Scene, pose: Pose2, yaws: FloatArray, elevations: FloatArray) -> FloatArray:
    """Return ranges (n_lines, n_beams) [m]; inf where nothing is hit. The lever is radial.

    Elevations are (n_beams,), or (n_lines, n_beams).
    """
    headings = pose.yaw + yaws
    d = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    origin = np.array([pose.x, pose.y]) + MOUNT[0, 3] * d
    a, b = scene.segments[:, 0], scene.segments[:, 1]
    edge = b - a
    to_a = a[None] - origin[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        det = d[:, None, 0] * edge[None, :, 1] - d[:, None, 1] * edge[None, :, 0]
        rho = (to_a[..., 0] * edge[None, :, 1] - to_a[..., 1] * edge[None, :, 0]) / det
        along = (to_a[..., 0] * d[:, None, 1] - to_a[..., 1] * d[:, None, 0]) / det
    rho = np.where((along >= 0) & (along <= 1) & (rho > 0), rho, np.inf)
    result = np.full((len(yaws), elevations.shape[-1]), np.inf)
    rise = np.tan(elevations)
    for k in np.argsort(np.min(rho, axis=0))[::-1]:
        hit = rho[:, k]
        with np.errstate(invalid="ignore"):
            z = MOUNT[2, 3] + hit[:, None] * rise
            inside = np.isfinite(hit)[:, None] & (z > 0.03) & (z < scene.heights[k])
            distance = np.where(inside, hit[:, None] / np.cos(elevations), np.inf)
        result = np.minimum(result, distance)
    return result


@dataclass(frozen=True)
class Pair:
    """Two sweeps, the true and the guessed ``T_target_source``."""

    target: RangeImage
    source: RangeImage
    truth: Pose2
    init: Pose2


def pair(
    name: str,
    noise: Noise,
    seed: int,
    sigma_xy: float = 0.02,
    sigma_yaw: float = math.radians(2),
    lines: Lines = LINES["regular"],
) -> Pair:
    """Return a pair of scene ``name`` with a random initial error."""
    rng = np.random.default_rng([seed, len(name)])
    scene, half = SCENES[name](), HALF_WIDTH[name]
    move = Pose2(0.0, -BASELINE[name], math.radians(TURN[name]))
    first = Pose2(0.0, BASELINE[name] / 2, math.radians(-TURN[name] / 2))
    target = scan(scene, first, half, noise, rng, lines)
    second = first @ move
    source = scan(scene, second, half, noise, rng, lines)
    x, y, yaw = rng.standard_normal(3) * [sigma_xy, sigma_xy, sigma_yaw]
    init = Pose2(move.x + x, move.y + y, move.yaw + yaw)
    return Pair(target, source, move, init)


def point_error(points: FloatArray, estimate: FloatArray, truth: Pose2) -> float:
    """Return the RMS [m] over ``points`` (n, 3) of |T_est p - T_true p|, planar part."""
    return float(
        np.sqrt(
            np.mean(
                np.sum(
                    (Pose2.from_matrix(estimate).apply(points) - truth.apply(points)) ** 2, axis=1
                )
            )
        )
    )
