"""Readings that a damaged line has made, and no checksum tells, are left out of the lines.

A checksum of 8 bits misses 1 in 256 of larger damages, and two flips of the same bit; a standard
node has none. While the line is noisy, a reading must be near another one, of its neighbours or of
the lines before and after, and so must a short row of readings that are near only each other: what
is read a byte off is often as smooth as the surface.
"""

from __future__ import annotations

from dataclasses import replace

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


class ReadingFilter:
    """Drops readings that nothing near them supports, while the line is noisy.

    Then a line waits for the next one.

    Attributes:
        dropped: Number of readings dropped.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._bad = 0
        self._noisy_until = 0.0
        self._before: FloatArray | None = None
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
            lines.append(self._judge(self._waiting, line.ranges))
            self._before, self._waiting = lines[0].ranges, None

        # Let this one wait while the line is noisy
        if line.stamp <= self._noisy_until:
            self._waiting = line
        else:
            lines.append(line)
            self._before = line.ranges
        return lines

    def clear(self) -> None:
        """Forget the lines so far, after an interruption."""
        self._before = self._waiting = None

    def _judge(self, line: ScanLine, after: FloatArray) -> ScanLine:
        others = [after] if self._before is None else [self._before, after]
        supported = (
            find_supported(line.ranges, others)
            & find_supported_rows(line.ranges, others)
            & find_ordered(line)
        )
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
