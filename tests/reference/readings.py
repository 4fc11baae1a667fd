"""Plain forms of ``native/readings.h`` and ``native/near.h``, in NumPy."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, RangeImage


def mixed(
    ranges: FloatArray, elevations: FloatArray, yaws: FloatArray, noise: float, steepest: float
) -> BoolArray:
    """Return whether each reading (m, n) lies between its neighbours, far from both.

    Across lines, so is what is off the plane of the next two where the line before has no reading.
    """
    columns = np.broadcast_to(elevations, ranges.shape)
    found = _between(ranges, columns, noise, steepest)
    found |= _between(ranges.T, -yaws.T, noise, steepest).T
    found[1:-2] |= _off_end(ranges, noise)
    found[2:-1] |= _off_end(ranges[::-1], noise)[::-1]
    return found


def _off_end(ranges: FloatArray, noise: float) -> BoolArray:
    before, here, after, second = (ranges[k : len(ranges) - 3 + k] for k in range(4))
    straight = 1.0 / (2.0 / after - 1.0 / second)
    return np.isnan(before) & (np.abs(here - after) > noise) & (np.abs(here - straight) > noise)


def _between(ranges: FloatArray, angles: FloatArray, noise: float, steepest: float) -> BoolArray:
    rise = np.diff(ranges, axis=1)
    nearer = np.minimum(ranges[:, 1:], ranges[:, :-1])
    step = np.maximum(noise, nearer * np.diff(angles, axis=1) * steepest)
    up, down = rise > step, rise < -step
    found = np.zeros(ranges.shape, dtype=bool)
    found[:, 1:-1] = (up[:, :-1] & up[:, 1:]) | (down[:, :-1] & down[:, 1:])
    return found


def filled(
    ranges: FloatArray, elevations: FloatArray, yaws: FloatArray, widest: float, deepest: float
) -> FloatArray:
    """Return ``ranges`` (m, n) with narrow, shallow gaps filled, along lines and then across."""
    columns = np.broadcast_to(elevations, ranges.shape)
    along = _filled_rows(ranges, columns, widest, deepest)
    return _filled_rows(along.T, -yaws.T, widest, deepest).T


def _filled_rows(
    ranges: FloatArray, angles: FloatArray, widest: float, deepest: float
) -> FloatArray:
    valid = np.isfinite(ranges)
    columns = np.broadcast_to(np.arange(ranges.shape[1]), ranges.shape)
    before = _running_max(np.where(valid, columns, -1))
    after = _running_max(np.where(valid, -columns, -ranges.shape[1])[:, ::-1])[:, ::-1] * -1
    bounded = ~valid & (before >= 0) & (after < ranges.shape[1])
    row, column = np.nonzero(bounded)
    a, b = (row, before[bounded]), (row, after[bounded])
    width = angles[b] - angles[a]
    narrow = (width <= widest) & (np.abs(ranges[b] - ranges[a]) <= deepest)
    share = (angles[row, column] - angles[a]) / np.where(width > 0, width, 1.0)
    result = ranges.copy()
    result[row[narrow], column[narrow]] = (ranges[a] + share * (ranges[b] - ranges[a]))[narrow]
    return result


def _running_max(values: IntArray) -> IntArray:
    running: IntArray = np.maximum.accumulate(values, axis=1)
    return running


def free_reach(
    floor: FloatArray, solid: FloatArray, start: float, most: float, margin: float
) -> FloatArray:
    """Return the farthest floor (m,) before a hole or an obstacle; hits (m, k), inf for none."""
    first = np.full((len(floor), 1), start)
    hits = np.concatenate([first, np.sort(floor, axis=1), np.full_like(first, np.inf)], axis=1)
    hole = ~np.isfinite(hits[:, 1:])
    np.greater(hits[:, 1:] - np.where(hole, 0.0, hits[:, :-1]), most, out=hole, where=~hole)
    last = np.argmax(hole, axis=1)
    reach = np.where(last > 0, hits[np.arange(len(hits)), last], 0.0)
    return np.minimum(reach, solid.min(axis=1) - margin)


def is_near(places: FloatArray, points: FloatArray, within: float) -> BoolArray:
    """Return whether each of ``places`` (m, 3) has one of ``points`` (n, 3) within a radius."""
    squares = np.sum((places[:, None] - points) ** 2, axis=2)
    return np.asarray((squares < within * within).any(axis=1))


def placed(
    image: RangeImage, wanted: BoolArray
) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
    """Return points (n, 3), lines, beams and distances (n,) of the readings ``wanted`` (m, n)."""
    points, (lines, beams) = image.points[wanted], np.nonzero(wanted)
    return points, lines, beams, np.hypot(points[:, 0], points[:, 1])


def neighbours(
    ranges: FloatArray, elevations: FloatArray, yaws: FloatArray, noise: float, steepest: float
) -> IntArray:
    """Return how many of the eight readings around each can lie on its surface (m, n)."""
    columns, count = np.broadcast_to(elevations, yaws.shape), np.zeros(ranges.shape, dtype=int)
    every, before, after = np.s_[:], np.s_[:-1], np.s_[1:]
    for a, b in (
        ((every, after), (every, before)),
        ((after, every), (before, every)),
        ((after, after), (before, before)),
        ((after, before), (before, after)),
    ):
        angle = np.hypot(yaws[a] - yaws[b], columns[a] - columns[b])
        step = np.maximum(noise, np.minimum(ranges[a], ranges[b]) * angle * steepest)
        near = np.abs(ranges[a] - ranges[b]) <= step
        count[a] += near
        count[b] += near
    return count


def meet_planes(
    image: RangeImage, met: BoolArray, normals: FloatArray, offsets: FloatArray
) -> FloatArray:
    """Return the ranges (m, n) at which rays meet planes, NaN where ``met`` (m, n) is False."""
    eyes, rays = _cast_rays(image, met)
    ranges = np.full(met.shape, np.nan)
    ranges[met] = (offsets - np.sum(normals * eyes, axis=1)) / np.sum(normals * rays, axis=1)
    return ranges


def near_points(
    image: RangeImage, met: BoolArray, ranges: FloatArray, points: FloatArray, limits: FloatArray
) -> BoolArray:
    """Return which rays pass ``points`` (k, 3) within ``limits`` (k,), at ``ranges`` (m, n) > 0."""
    eyes, rays = _cast_rays(image, met)
    off = eyes + ranges[met][:, None] * rays - points
    across = off - np.sum(off * rays, axis=1, keepdims=True) * rays
    return np.asarray((np.sqrt(np.sum(across**2, axis=1)) < limits) & (ranges[met] > 0))


def _cast_rays(image: RangeImage, where: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions (k, 3) of the rays ``where`` (m, n) is True."""
    lines, beams = np.nonzero(where)
    directions = np.broadcast_to(image.beams, (*where.shape, 3))[lines, beams]
    c, s = np.cos(image.yaws[where]), np.sin(image.yaws[where])

    def turned(vectors: FloatArray) -> FloatArray:
        x, y, z = np.broadcast_to(vectors, (len(c), 3)).T
        return np.stack([c * x - s * y, s * x + c * y, z], axis=1)

    return turned(image.T_base_lidar[:3, 3]), turned(directions)
