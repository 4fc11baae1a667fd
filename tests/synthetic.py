"""Test helper: range images of boxes and a floor in closed form, without a simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from scan3d_twin.core.hal import default_mount
from scan3d_twin.core.types import (
    VALID,
    FloatArray,
    IntArray,
    LidarSpec,
    Observation,
    Pose2,
    RangeImage,
    read_only,
)

ROOM = ((-2.5, 2.5), (-2.0, 2.0), (0.0, 2.5))


@dataclass(frozen=True)
class Box:
    """An axis-aligned box by its corners [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


THREE_BOXES = (
    Box((0.60, 0.35, 0.0), (1.00, 1.15, 0.6)),
    Box((0.75, -0.15, 0.0), (1.05, 0.25, 0.4)),
    Box((0.65, -1.15, 0.0), (1.15, -0.25, 0.7)),
)


def spec(n_beams: int = 682) -> LidarSpec:
    """Return a lidar with ``n_beams`` beams around the horizontal."""
    steps = np.arange(n_beams) - n_beams // 2
    return LidarSpec(
        elevations=read_only(steps * math.tau / 1024),
        beam_times=read_only((steps - steps[0]) * 0.1 / 1024),
        line_period=0.1,
        min_range=0.02,
        max_range=4.0,
    )


SPEC = spec()
Shift = Callable[[IntArray, IntArray], FloatArray]


def observe(
    pose: Pose2,
    boxes: tuple[Box, ...] = THREE_BOXES,
    *,
    width: float = math.radians(60.0),
    step: float = math.radians(0.5),
    room: bool = True,
    sigma: float = 0.0,
    rng: np.random.Generator | None = None,
    lidar: LidarSpec = SPEC,
    shift: Shift | None = None,
) -> Observation:
    """Return what a sweep around ``pose`` sees; ``T_odom_scan`` is the pose itself.

    ``shift`` of line and beam is how many beams higher than that of ``lidar`` an elevation is.
    """
    image = _sweep(width, step, lidar, shift)
    if lidar is SPEC:
        ranges = _exact_ranges(pose, boxes, width, step, room, shift)
    else:
        ranges = _cast_sweep(pose, boxes, image, room)
    if rng is not None:
        ranges = ranges + sigma * rng.standard_normal(ranges.shape)
    ranges = np.where(ranges <= 4.095, ranges, np.nan)
    codes = np.where(np.isfinite(ranges), VALID, 0)
    seen = RangeImage(
        image.stamps,
        image.yaws,
        read_only(ranges),
        read_only(codes, np.int64),
        lidar,
        image.T_base_lidar,
        image.elevations,
    )
    return Observation(seen, pose)


def _sweep(width: float, step: float, lidar: LidarSpec, shift: Shift | None) -> RangeImage:
    """Return the sweep whose readings are all 1 m."""
    yaws = np.arange(width / 2, -width / 2 - 1e-9, -step)
    return RangeImage(
        stamps=read_only(np.arange(len(yaws)) * 0.1),
        yaws=read_only(np.repeat(yaws[:, None], lidar.n_beams, axis=1)),
        ranges=read_only(np.ones((len(yaws), lidar.n_beams))),
        codes=read_only(np.full((len(yaws), lidar.n_beams), VALID), np.int64),
        spec=lidar,
        T_base_lidar=default_mount(),
        elevations=None if shift is None else _elevations(lidar, len(yaws), shift),
    )


@lru_cache(maxsize=32)
def _exact_ranges(
    pose: Pose2, boxes: tuple[Box, ...], width: float, step: float, room: bool, shift: Shift | None
) -> FloatArray:
    """Return the exact ranges of a sweep by ``SPEC``, which many tests take from the same place."""
    return read_only(_cast_sweep(pose, boxes, _sweep(width, step, SPEC, shift), room))


def _cast_sweep(pose: Pose2, boxes: tuple[Box, ...], image: RangeImage, room: bool) -> FloatArray:
    """Return the ranges at which the rays of ``image`` from ``pose`` meet something."""
    directions = pose.rotate(image.directions)
    origins = pose.apply(image.points - image.directions)
    ranges = cast(origins.reshape(-1, 3), directions.reshape(-1, 3), boxes, room)
    return ranges.reshape(image.ranges.shape)


def _elevations(lidar: LidarSpec, n_lines: int, shift: Shift) -> FloatArray:
    line, beam = np.arange(n_lines)[:, None], np.arange(lidar.n_beams)
    step = float(np.median(np.diff(lidar.elevations)))
    return read_only(lidar.elevations + step * shift(line, beam))


def interleaved(line: IntArray, beam: IntArray) -> FloatArray:
    """Every other line half a beam higher."""
    return np.asarray(0.5 * (line % 2) + 0.0 * beam)


def irregular(line: IntArray, beam: IntArray) -> FloatArray:
    """Each line at a phase and with steps of its own, each beam off by up to a quarter."""
    rng = np.random.default_rng(8)
    n_lines, n_beams = len(line), len(beam)
    phase = rng.uniform(-0.4, 0.4, (n_lines, 1))
    drift = rng.uniform(-0.5, 0.5, (n_lines, 1)) * (beam / n_beams - 0.5)
    return np.asarray(phase + drift + rng.uniform(-0.25, 0.25, (n_lines, n_beams)))


def cast(
    origins: FloatArray, directions: FloatArray, boxes: tuple[Box, ...], room: bool
) -> FloatArray:
    """Return the distance (n,) to the first surface along each ray; inf where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
        if room:
            walls = np.array(ROOM)
            exits = np.maximum(
                (walls[:, 0] - origins) / directions, (walls[:, 1] - origins) / directions
            )
            distance = np.minimum(distance, np.nanmin(exits, axis=1))
        for box in boxes:
            a = (np.array(box.low) - origins) / directions
            b = (np.array(box.high) - origins) / directions
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            hit = (enter <= leave) & (enter > 0)
            distance = np.where(hit, np.minimum(distance, enter), distance)
    return np.asarray(distance)
