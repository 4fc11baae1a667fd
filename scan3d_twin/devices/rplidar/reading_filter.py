"""Readings that a damaged line has made, and no checksum tells, are left out of the lines.

A checksum of 8 bits misses 1 in 256 of larger damages, and two flips of the same bit; a standard
node has none. While the line is noisy, a reading must be near another one, of its neighbours or of
the lines before and after, and so must a short row of readings that are near only each other: what
is read a byte off is often as smooth as the surface. And a reading that is off the surface by more
than noise, in its own line and beside both others, is a flip of low bits; so is one whose angle is
not that predicted by its neighbours and an even turn. Between many dropped readings the frame is
damaged, and what is left of it is dropped, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.types import (
    UNMEASURED,
    VALID,
    BoolArray,
    FloatArray,
    IntArray,
    ScanLine,
    read_only,
)
from scan3d_twin.devices.rplidar.model import RangeNoise

NOISY_TIME = 10.0
"""Time after a damaged frame during which the line is noisy [s]. At the rate at which two flips of
one bit reach one reading of 1e8, a dense C1 has 1 damaged frame in 10 s."""
REACH = 2
"""Number of places to either side in which a reading must have one near it."""
NEAR, NEAR_SHARE = 0.03, 0.02
"""Largest difference of two readings that are near each other [m], and as a share of the distance.
The noise of two readings of a C1 differs by 11 mm; a wall seen at 58 deg of incidence changes by
2 % a beam of .72 deg, and one seen more obliquely is near its reading in the line before."""
LOOSE, LOOSE_SHARE = 0.1, 0.1
"""The same for a row of readings and another line: a wall at 58 deg changes by 10 % in 3.9 deg,
which the robot turns from line to line of an A1 at .5 rad/s."""
LONGEST_ROW = 40
"""Readings of a row that a damaged capsule may have made alone: those of a capsule."""
MAX_DISORDER = 2.5
"""Largest deviation of a reading's time from that of its neighbours, in beams."""
FIT = 3
"""Readings on a side to which a straight surface is fitted."""
FIT_GAP = 2.0
"""Farthest of them, in places for each reading."""
WINDOW = 9
"""Readings over which two lines are shifted against each other: the robot turns between them."""
MAX_ANGLE_ERROR = 0.35
"""Largest error of an angle beside its neighbours, in beams; an A1 rounds angles to 1/8 deg, which
is 0.19 beams, and shifts those of neighbouring distances alike."""
COMPANY, MAX_DROPPED = 16, 3
"""Beams on either side of a reading, half of a capsule, and the number of dropped ones on both from
which on its frame is damaged."""
NOISE_BOUND = 4.0
"""Standard deviations that noise does not reach: 1 reading of 16000, which would have to be so far
off in each of up to five comparisons."""


class ReadingFilter:
    """Drops readings that nothing near them supports, while the line is noisy.

    Then a line waits for the next one.

    Attributes:
        dropped: Number of readings dropped.
    """

    def __init__(self, noise: RangeNoise) -> None:
        """Start without lines, of a lidar with ``noise``."""
        self._noise = noise
        self.dropped = 0
        self._bad = 0
        self._noisy_until = 0.0
        self._before: ScanLine | None = None
        self._waiting: ScanLine | None = None

    def take(self, line: ScanLine, bad: int) -> list[ScanLine]:
        """Take in a ``line``, in order of time; return the lines that are certain now.

        Args:
            line: As it arrived.
            bad: Number of damaged frames so far.
        """
        if bad > self._bad:
            self._noisy_until = line.stamp + NOISY_TIME
        self._bad = bad

        # Judge the line before by this one
        lines = []
        if self._waiting is not None:
            lines.append(self._judge(self._waiting, line))
            self._before, self._waiting = lines[0], None

        # Let this one wait while the line is noisy
        if line.stamp <= self._noisy_until:
            self._waiting = line
        else:
            lines.append(line)
            self._before = line
        return lines

    def clear(self) -> None:
        """Forget the lines so far, after an interruption."""
        self._before = self._waiting = None

    def _judge(self, line: ScanLine, after: ScanLine) -> ScanLine:
        lines = [after] if self._before is None else [self._before, after]
        others = [each.ranges for each in lines]
        supported = (
            find_supported(line.ranges, others)
            & find_supported_rows(line.ranges, others)
            & find_ordered(line)
            & find_at_expected_angle(line)
            & find_fitting(line, lines, self._noise)
        )
        supported &= find_in_good_company(line, (line.codes == VALID) & ~supported)
        dropped = (line.codes == VALID) & ~supported
        if not dropped.any():
            return line
        self.dropped += int(np.count_nonzero(dropped))
        ranges = np.where(dropped, np.nan, line.ranges)
        codes = np.where(dropped, UNMEASURED, line.codes)
        return replace(line, ranges=read_only(ranges), codes=read_only(codes, np.int64))


def find_supported(ranges: FloatArray, others: list[FloatArray]) -> BoolArray:
    """Return which of the ``ranges`` (n,) [m] have one near them within ``REACH`` places.

    Args:
        ranges: Distances of a line; NaN where there is none.
        others: Those of the lines before and after.
    """
    shifted = [_shifted(ranges, shift) for shift in range(-REACH, REACH + 1) if shift]
    shifted += [_shifted(other, shift) for other in others for shift in range(-REACH, REACH + 1)]
    tolerance = NEAR + NEAR_SHARE * ranges
    return np.asarray(np.any([np.abs(each - ranges) <= tolerance for each in shifted], axis=0))


def find_supported_rows(ranges: FloatArray, others: list[FloatArray]) -> BoolArray:
    """Return which of the ``ranges`` (n,) [m] are in a long row or in one like another line's.

    A row is a series of readings each near the next; half of a short one must be loosely near a
    reading of the lines before and after. Arguments as for ``find_supported``.
    """
    # Cut the line into rows
    at = np.flatnonzero(np.isfinite(ranges))
    if not len(at):
        return np.ones(len(ranges), dtype=bool)
    distances = ranges[at]
    cut = np.abs(np.diff(distances)) > NEAR + NEAR_SHARE * distances[1:]
    rows: IntArray = np.concatenate(([0], np.cumsum(cut)))

    # Compare with the other lines
    tolerance = LOOSE + LOOSE_SHARE * ranges
    shifted = [_shifted(other, shift) for other in others for shift in range(-REACH, REACH + 1)]
    near = np.any([np.abs(each - ranges) <= tolerance for each in shifted], axis=0)
    length, count = np.bincount(rows), np.bincount(rows, weights=near[at])
    supported = np.ones(len(ranges), dtype=bool)
    supported[at] = ((length > LONGEST_ROW) | (2 * count >= length))[rows]
    return supported


def find_ordered(line: ScanLine) -> BoolArray:
    """Return which readings (n,) of ``line`` were taken when their neighbours were.

    A damaged angle puts a reading in a place where others were taken at another time.
    """
    ordered = np.ones(len(line.ranges), dtype=bool)
    at = np.flatnonzero(line.codes != UNMEASURED)
    if line.beam_times is None or len(at) < 2 * REACH + 1:
        return ordered
    times = line.beam_times[at]
    windows = np.lib.stride_tricks.sliding_window_view(times, 2 * REACH + 1)
    beam = np.median(np.diff(times))
    off = np.abs(times[REACH:-REACH] - np.median(windows, axis=1))
    ordered[at[REACH:-REACH]] = off <= MAX_DISORDER * beam
    return ordered


def find_fitting(line: ScanLine, others: list[ScanLine], noise: RangeNoise) -> BoolArray:
    """Return which readings (n,) of ``line`` fit its surface, or that of one of the ``others``.

    A surface is a straight line through the readings on the left, on the right, or on both sides;
    of another line it is the readings there, shifted by the median difference of those nearby.
    Where there are too few readings for either, the reading is accepted.
    """
    fitting = np.ones(len(line.ranges), dtype=bool)
    at = np.flatnonzero(line.codes == VALID)
    if line.elevations is None or len(at) < WINDOW:
        return fitting
    ranges, bounds = line.ranges[at], NOISE_BOUND * noise.at(line.ranges[at])

    # In its own line, and in the others
    errors = [fit.error for fit in _fit_sides(line.elevations[at], ranges, at, ranges)]
    own, known = _compare(errors, bounds)
    shifts = [_shift_to(each, line.elevations[at], ranges) for each in others]
    beside, known_beside = _compare(shifts, math.sqrt(2.0) * bounds)
    fitting[at] = own | beside | ~known | ~known_beside
    return fitting


def find_at_expected_angle(line: ScanLine) -> BoolArray:
    """Return which readings (n,) of ``line`` have the angle predicted by an even turn.

    It is predicted from neighbours of similar distance that agree with each other; without any the
    angle is accepted.
    """
    expected = np.ones(len(line.ranges), dtype=bool)
    at = np.flatnonzero(line.codes == VALID)
    if line.elevations is None or line.beam_times is None or len(at) < WINDOW:
        return expected
    angles, ranges = line.elevations[at], line.ranges[at]
    bound = MAX_ANGLE_ERROR * float(np.median(np.diff(angles)))
    near = FIT * (NEAR + NEAR_SHARE * ranges)
    errors = [
        np.where((fit.bend <= bound / 2) & (fit.depth <= near), fit.error, np.nan)
        for fit in _fit_sides(line.beam_times[at], angles, at, ranges)
    ]
    within, known = _compare(errors, np.full(len(at), bound))
    expected[at] = within | ~known
    return expected


def find_in_good_company(line: ScanLine, dropped: BoolArray) -> BoolArray:
    """Return which readings (n,) of ``line`` were not taken between many that are ``dropped``."""
    times = line.beam_times
    if times is None or np.count_nonzero(dropped) < 2 * MAX_DROPPED:
        return np.ones(len(dropped), dtype=bool)
    reach = COMPANY * float(np.median(np.diff(np.sort(times[line.codes != UNMEASURED]))))
    bad = np.sort(times[dropped])
    until, by = np.searchsorted(bad, times), np.searchsorted(bad, times, side="right")
    before = until - np.searchsorted(bad, times - reach)
    after = np.searchsorted(bad, times + reach, side="right") - by
    return np.asarray(np.minimum(before, after) < MAX_DROPPED)


def _compare(errors: list[FloatArray], bounds: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return where any of the ``errors`` is within ``bounds``, and where any is known."""
    within = np.any([np.abs(error) <= bounds for error in errors], axis=0)
    return np.asarray(within), np.asarray(np.any(np.isfinite(errors), axis=0))


@dataclass(frozen=True, slots=True)
class _Fit:
    """Readings beside straight lines fitted to some of their neighbours, one for each of n.

    Attributes:
        error: By how much they are off, over the standard deviation of it that noise of 1 makes
            (n,); NaN where a neighbour is missing.
        bend: Largest error of a neighbour (n,).
        depth: Largest difference of their distances (n,) [m].
    """

    error: FloatArray
    bend: FloatArray
    depth: FloatArray


def _fit_sides(x: FloatArray, y: FloatArray, at: IntArray, ranges: FloatArray) -> list[_Fit]:
    """Return the fits of ``y`` over ``x`` (n,) to the neighbours on the left, right and both sides.

    Args:
        x: Angles or times.
        y: What is fitted.
        at: Places of the readings (n,).
        ranges: Their distances (n,) [m].
    """
    left, right = range(-FIT, 0), range(1, FIT + 1)
    fits = []
    for side in (left, right, (*left, *right)):
        xs, ys, depths, places = (
            np.array([_shifted(each, -k) for k in side]) - each
            for each in (x, y, ranges, at.astype(np.float64))
        )
        complete = np.abs(places).max(axis=0) <= FIT * FIT_GAP

        # The line at the reading's own x, which is 0 here
        offsets = xs - xs.mean(axis=0)
        spread = (offsets**2).sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (offsets * ys).sum(axis=0) / spread
            sigma = np.sqrt(1.0 + 1.0 / len(side) + xs.mean(axis=0) ** 2 / spread)
            error = (slope * xs.mean(axis=0) - ys.mean(axis=0)) / sigma
            bend = np.abs(ys - ys.mean(axis=0) - slope * offsets).max(axis=0)
        depth = np.abs(depths).max(axis=0)
        fits.append(_Fit(np.where(complete, error, np.nan), bend, depth))
    return fits


def _shift_to(other: ScanLine, angles: FloatArray, ranges: FloatArray) -> FloatArray:
    """Return by how much ``ranges`` (n,) [m] at ``angles`` [rad] are off those of ``other``.

    NaN where it has no readings on both sides.
    """
    at = np.flatnonzero(other.codes == VALID)
    if other.elevations is None or len(at) < WINDOW:
        return np.full(len(ranges), np.nan)
    there = other.elevations[at]
    step = math.tau / len(other.ranges)
    following = np.searchsorted(there, angles).clip(1, len(at) - 1)
    gap = there[following] - there[following - 1] > 2 * FIT_GAP * step
    differences = np.where(gap, np.nan, ranges - np.interp(angles, there, other.ranges[at]))
    padded = np.pad(differences, WINDOW // 2, mode="wrap")
    windows = np.lib.stride_tricks.sliding_window_view(padded, WINDOW)
    return np.asarray(differences - _medians(windows))


def _medians(windows: FloatArray) -> FloatArray:
    """Return the medians of ``windows`` (n, m) without their NaN; NaN where there is nothing else.

    Of an even number the lower of the two in the middle.
    """
    count = np.isfinite(windows).sum(axis=1)
    middle = np.maximum(count - 1, 0) // 2
    return np.asarray(np.sort(windows, axis=1)[np.arange(len(windows)), middle])


def _shifted(values: FloatArray, by: int) -> FloatArray:
    """Return ``values`` moved on by some places, NaN where none are moved to."""
    moved = np.full(len(values), np.nan)
    if by > 0:
        moved[by:] = values[:-by]
    elif by < 0:
        moved[:by] = values[-by:]
    else:
        moved[:] = values
    return moved
