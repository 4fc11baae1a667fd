"""Beams at any angles on the grid of lines and beams that a sweep is made of.

Beam j of every line lies near elevation j of the ``LidarSpec``, so that neighbours in the grid are
neighbours in space; its own elevation says exactly where. Lidars whose beams lie elsewhere in each
revolution are arranged like that line by line. A grid that has several columns for each beam of a
line, as when every other line is shifted by half a beam, is packed: empty columns in between would
leave readings without neighbours.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import (
    UNMEASURED,
    VALID,
    BoolArray,
    FloatArray,
    IntArray,
    LidarSpec,
    RangeImage,
    ScanLine,
    read_only,
)

MAX_COLUMNS_PER_BEAM = 4
"""Most columns of a grid for one beam that are recognised (assumption)."""
MAX_ADJACENT_SHARE = 0.25
"""Share of readings with one beside them from which on a grid is dense, whatever is missing."""
MIN_REGULAR_SHARE = 0.5
"""Least share of readings with one in the next beam's column in a grid of several for each."""
PROBED_LINES = 8
"""Lines of a sweep in which they are looked for: about a thousand readings."""


def make_full_circle(
    points: int, line_period: float, min_range: float, max_range: float
) -> LidarSpec:
    """Return the grid of the lines of a lidar that sees all round.

    Its elevations go from -180 deg, behind, over the floor, the front (the middle beam, 0) and the
    zenith to 180 deg, in the order of time. The seam between two lines is behind, where it parts
    nothing in front of the robot; a place is added beyond either end, as beams lie off the places.

    Args:
        points: Number of places all round: at least the most readings of a revolution.
        line_period: Duration of a revolution, nominally [s].
        min_range: Shortest distance that the lidar reports [m].
        max_range: Longest distance that is trusted [m].
    """
    half = points // 2 + 1
    turns = np.arange(-half, half + 1) / points
    return LidarSpec(
        elevations=read_only(math.tau * turns),
        beam_times=read_only(line_period * np.clip(turns + 0.5, 0.0, 1.0 - 1.0 / points)),
        line_period=line_period,
        min_range=min_range,
        max_range=max_range,
    )


def arrange_line(
    spec: LidarSpec,
    stamp: float,
    elevations: FloatArray,
    beam_times: FloatArray,
    ranges: FloatArray,
    codes: IntArray,
) -> ScanLine:
    """Return m readings, in any order, as a line of the grid of ``spec``.

    Each takes the place of the nearest elevation of ``spec``, up to a shift of the whole line. Of
    two that want the same place the nearer one takes it; the other moves to the next place on its
    side if that is free, and is dropped otherwise. No reading is lost if ``spec`` is at least as
    dense as the beams ever are. Places without a reading are ``UNMEASURED``. Readings beyond the
    ends of ``spec`` are dropped.

    Args:
        spec: Its elevations ascend.
        stamp: Time of the line [s].
        elevations: Beam angles (m,) [rad].
        beam_times: Times after the stamp (m,) [s].
        ranges: Distances (m,) [m]; NaN where there is no valid return.
        codes: Error codes (m,), ``VALID`` where ``ranges`` is a distance.

    Raises:
        ConfigError: The arrays are of different lengths or hold no finite angle.
    """
    # Find the reading of each place
    parts = (elevations, beam_times, ranges, codes)
    if len({np.shape(part) for part in parts}) > 1 or not np.any(np.isfinite(elevations)):
        raise ConfigError(f"a line of {np.shape(elevations)} angles, expected one per reading")
    order, n = _sort_by_angle(elevations), spec.n_beams
    taken, own = place_readings(spec, elevations)

    # Fill the line
    line = ScanLine(
        stamp=stamp,
        ranges=np.full(n, np.nan),
        codes=np.full(n, UNMEASURED, dtype=np.int64),
        elevations=spec.elevations.copy(),
        beam_times=np.interp(spec.elevations, elevations[order], beam_times[order]),
    )
    filled = (line.ranges, line.codes, line.elevations, line.beam_times)
    for array, part in zip(filled, (ranges, codes, elevations, beam_times), strict=True):
        assert array is not None
        array[taken] = part[own]
        array.flags.writeable = False
    return line


def place_readings(spec: LidarSpec, elevations: FloatArray) -> tuple[BoolArray, IntArray]:
    """Return which places of ``spec`` are taken (n_beams,), and by which reading each (k,).

    Args:
        spec: The grid, see ``arrange_line``.
        elevations: Beam angles (m,) [rad], of which one is finite.
    """
    order = _sort_by_angle(elevations)
    positions = _find_positions(spec.elevations, elevations[order])
    owner = _assign_places(positions, spec.n_beams)
    taken = owner >= 0
    return taken, order[owner[taken]]


def _sort_by_angle(elevations: FloatArray) -> IntArray:
    """Return the indices of the finite ``elevations`` (m,), the smallest first."""
    order = np.argsort(elevations, kind="stable")
    return np.asarray(order[np.isfinite(elevations[order])])


def _find_positions(nominal: FloatArray, elevations: FloatArray) -> FloatArray:
    """Return the positions (m,) of ascending ``elevations`` in ``nominal`` (n,), 0 to n - 1.

    Those beyond the ends lie as far outside, by the spacing there.
    """
    positions = np.interp(elevations, nominal, np.arange(len(nominal)))
    below, above = elevations < nominal[0], elevations > nominal[-1]
    first, last = nominal[1] - nominal[0], nominal[-1] - nominal[-2]
    positions[below] = (elevations[below] - nominal[0]) / first
    positions[above] += (elevations[above] - nominal[-1]) / last
    return positions


def _assign_places(positions: FloatArray, n: int) -> IntArray:
    """Return which reading (m,), by its position, takes each of ``n`` places (n,); -1 for none.

    Their mean distance from whole positions is taken off first: evenly spaced beams half a place
    off would be rounded up or down by chance.
    """
    turns = np.mean(np.exp(2j * np.pi * positions))
    common = np.angle(turns) / (2 * np.pi)
    places = np.rint(positions - common).astype(np.int64)
    inside = np.flatnonzero((places >= 0) & (places < n))
    owner = np.full(n, -1, dtype=np.int64)

    # The nearest reading is written last
    off = positions - common - places
    by_distance = inside[np.argsort(-np.abs(off[inside]), kind="stable")]
    owner[places[by_distance]] = by_distance

    # The others go to the next place if it is free
    others = by_distance[owner[places[by_distance]] != by_distance]
    beside = places[others] + np.where(off[others] < 0, -1, 1)
    free = (beside >= 0) & (beside < n)
    free[free] = owner[beside[free]] < 0
    owner[beside[free]] = others[free]
    return owner


def count_columns_per_beam(codes: IntArray) -> int:
    """Return how many columns of the grid there are for one beam of a line; 1 for a dense grid.

    In a grid with k columns for one beam most readings have a neighbour k columns on, but few have
    one beside them: readings that are missing by chance leave as many neighbours at any distance.

    Args:
        codes: Error codes of a sweep (n_lines, n_beams).
    """
    valid = codes[:: max(1, len(codes) // PROBED_LINES)] == VALID
    n = np.count_nonzero(valid)
    if _count_neighbours(valid, 1) >= MAX_ADJACENT_SHARE * n:
        return 1
    for k in range(2, MAX_COLUMNS_PER_BEAM + 1):
        if _count_neighbours(valid, k) >= MIN_REGULAR_SHARE * n:
            return k
    return 1


def _count_neighbours(valid: BoolArray, columns: int) -> int:
    """Return how many readings have another one ``columns`` on in their line."""
    return int(np.count_nonzero(valid[:, columns:] & valid[:, :-columns]))


def find_packed_columns(codes: IntArray) -> IntArray | None:
    """Return the column of each reading of the packed grid (n_lines, n); None if it is dense.

    Of the columns of one beam the first with a distance is taken.

    Args:
        codes: Error codes of a sweep (n_lines, n_beams).
    """
    k = count_columns_per_beam(codes)
    if k == 1:
        return None
    groups = _group_columns(codes.shape[1], k)
    known = 2 * (codes == VALID)[:, groups] + (codes != UNMEASURED)[:, groups]
    return np.asarray(groups[np.arange(len(groups)), np.argmax(known, axis=2)])


def _group_columns(n_beams: int, k: int) -> IntArray:
    """Return the columns of each beam (n, k); those beyond the last one repeat it."""
    columns = np.arange(k * -(-n_beams // k)).reshape(-1, k)
    return np.minimum(columns, n_beams - 1)


def pack_columns(image: RangeImage, columns: IntArray) -> RangeImage:
    """Return ``image`` with the ``columns`` (n_lines, n) of each line, by ``find_packed_columns``.

    Its ``spec`` has the mean elevation and time of each beam.
    """
    # Take the columns of each line
    every = np.broadcast_to(image.elevation_rows, image.ranges.shape)
    yaws, ranges, codes, elevations = (
        np.take_along_axis(each, columns, axis=1)
        for each in (image.yaws, image.ranges, image.codes, every)
    )

    # Describe the beams they come from
    spec = image.spec
    groups = _group_columns(spec.n_beams, -(-spec.n_beams // columns.shape[1]))
    packed = replace(
        spec,
        elevations=read_only(spec.elevations[groups].mean(axis=1)),
        beam_times=read_only(spec.beam_times[groups].mean(axis=1)),
    )
    return replace(
        image,
        yaws=read_only(yaws),
        ranges=read_only(ranges),
        codes=read_only(codes, np.int64),
        spec=packed,
        elevations=read_only(elevations),
    )
