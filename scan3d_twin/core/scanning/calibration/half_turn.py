"""A panorama of half a turn, by a lidar that sees all round: both halves of each revolution count.

While the base turns from a quarter turn on one side to a quarter turn on the other, the front half
of the revolutions sees what is ahead, and the back half what is behind. ``unfold`` makes lines of
both that all look ahead, as a full turn would have them: it turns the readings of the back half by
pi about the yaw axis. The lidar is not on this axis, so that their ranges, elevations and yaws are
computed anew from the points P, which stay where they are: with t, R the mount and k = R e_y the
normal of the scan plane, P is seen at the yaw psi at which it lies in that plane,

    k . Rz(-psi) P = k . t,    v = R^T (Rz(-psi) P - t),    r = |v|,    elevation = atan2(v_z, v_x).

The back half above the horizon comes at the end of a revolution, that below it at the start of the
next one: together they are a line whose beams follow each other in time.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.types import (
    UNMEASURED,
    BoolArray,
    FloatArray,
    IntArray,
    LidarSpec,
    RangeImage,
    ScanLine,
    read_only,
)

MAX_PERIODS_APART = 1.5
"""Time between two revolutions, in periods, up to which nothing is missing between them."""


def sees_all_round(spec: LidarSpec) -> bool:
    """Return whether the beams of a lidar leave out no direction of their plane."""
    spacing = float(np.median(np.diff(spec.elevations)))
    return float(spec.elevations[-1] - spec.elevations[0]) > math.tau - 1.5 * spacing


def is_unfolded(image: RangeImage) -> bool:
    """Return whether ``image`` has two lines for each revolution, as ``unfold`` makes them."""
    if image.n_lines < 3:
        return False
    apart = float(np.median(np.diff(np.sort(image.stamps))))
    return apart < 0.75 * image.spec.line_period


def unfold(image: RangeImage) -> RangeImage:
    """Return half a turn of a lidar that sees all round as a full turn of one that looks ahead.

    Args:
        image: Lines ordered by falling yaw, from a quarter turn to the left on. What is farther
            than a quarter turn to either side is left out.
    """
    # Take the front half of each line
    spec = image.spec
    front = np.flatnonzero(np.abs(spec.elevations) <= math.pi / 2)
    narrow = replace(
        spec,
        elevations=read_only(spec.elevations[front]),
        beam_times=read_only(spec.beam_times[front]),
    )
    every = np.broadcast_to(image.elevation_rows, image.ranges.shape)
    ahead = [
        (float(image.stamps[i]), image.yaws[i, front], _take(image, every, i, front))
        for i in range(image.n_lines)
        if abs(image.yaws[i, spec.n_beams // 2]) <= math.pi / 2
    ]

    # Turn the back half of each revolution
    behind = [
        line for i, j in _pair_revolutions(image) if (line := _turn(image, every, i, j, narrow))
    ]

    # Sort all lines by yaw
    middle = narrow.n_beams // 2
    lines = sorted([*ahead, *behind], key=lambda line: -line[1][middle])
    return RangeImage(
        stamps=read_only([stamp for stamp, _, _ in lines]),
        yaws=read_only([yaws for _, yaws, _ in lines]),
        ranges=read_only([line.ranges for _, _, line in lines]),
        codes=read_only([line.codes for _, _, line in lines], np.int64),
        spec=narrow,
        T_base_lidar=image.T_base_lidar,
        elevations=read_only(np.array([line.elevations for _, _, line in lines])),
    )


_Line = tuple[float, FloatArray, ScanLine]
"""Stamp of a line [s], yaw of each of its beams (n_beams,) [rad], and the line."""


def _take(image: RangeImage, elevations: FloatArray, i: int, beams: IntArray) -> ScanLine:
    """Return some ``beams`` of line ``i``, with its ``elevations`` (n_lines, n_beams) [rad]."""
    own = elevations[i, beams]
    return ScanLine(float(image.stamps[i]), image.ranges[i, beams], image.codes[i, beams], own)


def _pair_revolutions(image: RangeImage) -> list[tuple[int, int]]:
    """Return the pairs of lines (i, j) of which j is the revolution right after i."""
    order = np.argsort(image.stamps, kind="stable")
    apart = np.diff(image.stamps[order]) / image.spec.line_period
    return [(int(order[k]), int(order[k + 1])) for k in np.flatnonzero(apart < MAX_PERIODS_APART)]


def _turn(
    image: RangeImage, elevations: FloatArray, i: int, j: int, spec: LidarSpec
) -> _Line | None:
    """Return the back half between revolutions ``i`` and ``j`` as a line of ``spec``.

    None if it looks to where the front half of another revolution looks.
    """
    # Join the end of one revolution and the start of the next
    parts = ((i, elevations[i] > math.pi / 2), (j, elevations[j] < -math.pi / 2))
    own = [(line, beams & (image.codes[line] != UNMEASURED)) for line, beams in parts]
    e, yaws, ranges, codes = (
        np.concatenate([array[line, beams] for line, beams in own])
        for array in (elevations, image.yaws, image.ranges, image.codes)
    )
    if not (len(own[0][1]) and own[0][1].any() and own[1][1].any()):
        return None
    horizon = float(yaws[np.argmin(np.abs(np.abs(e) - math.pi))])
    if abs(horizon) > math.pi / 2:
        return None

    # See the points ahead, from half a turn on
    turned = yaws - math.copysign(math.pi, horizon)
    e, turned, ranges = _see_ahead(image, e, yaws, turned, ranges)

    # Arrange them; yaws are interpolated for places without a reading as times are
    line = arrange_line(spec, 0.0, e, turned, ranges, codes)
    assert line.beam_times is not None
    return float(image.stamps[i]) + spec.line_period / 2, line.beam_times, line


def _see_ahead(
    image: RangeImage, e: FloatArray, yaws: FloatArray, turned: FloatArray, ranges: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return elevations, yaws near ``turned`` [rad], ranges [m] that see points ahead (n,) each.

    The points are those seen at elevations ``e``, ``yaws`` and ``ranges`` (n,); where there is no
    range, the direction is that of a point at the longest one.
    """
    # Place the points in the base at the yaw ``turned``
    seen: BoolArray = np.isfinite(ranges)
    reach = np.where(seen, ranges, image.spec.max_range)
    R, t = image.T_base_lidar[:3, :3], image.T_base_lidar[:3, 3]
    at = t + reach[:, None] * (np.cos(e)[:, None] * R[:, 0] + np.sin(e)[:, None] * R[:, 2])
    at = _rotate(at, yaws - turned)

    # Turn on until the scan plane holds each point
    k = R[:, 1]
    rho, phi = np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])
    share = (k @ t - k[2] * at[:, 2]) / np.maximum(math.hypot(k[0], k[1]) * rho, 1e-9)
    left = phi - math.atan2(k[1], k[0]) + np.arccos(np.clip(share, -1.0, 1.0))
    left = (left + math.pi) % math.tau - math.pi
    v = (_rotate(at, -left) - t) @ R
    distances = np.where(seen, np.linalg.norm(v, axis=1), np.nan)
    return np.arctan2(v[:, 2], v[:, 0]), turned + left, distances


def _rotate(points: FloatArray, angles: FloatArray) -> FloatArray:
    """Return ``points`` (n, 3), each rotated about z by its angle (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = points.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)
