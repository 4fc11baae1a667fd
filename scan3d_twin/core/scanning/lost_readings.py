"""Readings that were lost on their way from the lidar: what to scan again, and what to doubt.

A garbled line arrives with some of its readings ``LOST``. Wide holes in the range image are scanned
again; narrow ones are filled like other gaps.

A short checksum misses some errors. In a sweep with lost readings a distance is therefore doubted
where none of its neighbours in the image is like it, together with those beside it that the same
checksum covered.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.moving_windows import are_all
from scan3d_twin.core.scanning.deskew import Lines
from scan3d_twin.core.scanning.gap_filling import fill_gaps
from scan3d_twin.core.types import (
    LOST,
    UNMEASURED,
    BoolArray,
    FloatArray,
    RangeImage,
    ScanLine,
    read_only,
)

NEIGHBOURHOOD = 2
"""Lines and beams around a reading in which one like it is looked for: of the readings of an intact
sweep 4e-5 (three boxes) to 3e-4 (a box with a wavy side) have none."""
LIKE = 0.06
"""Difference of two ranges up to which they are alike [m]: below 64 mm, the least by which a wrong
second character of SCIP changes a distance. With 30 mm, edges of things are lost line after line,
and a sweep over a line with one bad byte in 300 takes half as long again."""
DOUBTED_BEAMS = 21
"""Beams on either side of a doubted reading that are doubted too: the 64 characters under one
checksum of SCIP hold 21 readings."""

Interval = tuple[float, float]
"""Headings (left, right) of an interval [rad], left > right."""


def find_holes(
    yaws: FloatArray, lost: BoolArray, half: float, spacing: float, width: float, beams: int
) -> list[Interval]:
    """Return the intervals in which neighbouring beams have lost several lines in a row.

    Overlapping intervals are merged. Missing lines are no holes: ``find_missing`` finds them.

    Args:
        yaws: Headings of the lines, in any order (n,) [rad].
        lost: Which readings are lost (n, n_beams).
        half: Half the angle of the sweep, from ``half`` to ``-half`` [rad].
        spacing: Nominal angle between two lines [rad].
        width: Angle between two readings of a beam above which there is a hole [rad].
        beams: Number of neighbouring beams of a line that must be lost; fewer are no hole.
    """
    # Let each beam stand for the group around it
    lost = are_all(lost, max(1, beams), axis=1, beyond=False)

    # Order the lines, between two ends that count as read
    inside = np.flatnonzero(np.abs(yaws) <= half + spacing / 2)
    if not lost[inside].any():
        return []
    order = inside[np.argsort(-yaws[inside], kind="stable")]
    edges = np.concatenate(([half + spacing / 2], yaws[order], [-half - spacing / 2]))
    known = np.pad(~lost[order], ((1, 1), (0, 0)), constant_values=True)

    # Find the reading before each reading of the same beam
    index = np.arange(len(edges))[:, None]
    latest = np.maximum.accumulate(np.where(known, index, 0), axis=0)
    after, beam = np.nonzero(known[1:] & ~known[:-1])
    before = latest[after, beam]
    wide = edges[before] - edges[after + 1] > width
    pairs = set(zip(before[wide].tolist(), (after[wide] + 1).tolist(), strict=True))
    return merge_intervals([(float(edges[i]), float(edges[j])) for i, j in pairs], 0.0)


def merge_intervals(intervals: list[Interval], gap: float) -> list[Interval]:
    """Return ``intervals`` from left to right, those less than ``gap`` [rad] apart as one."""
    merged: list[Interval] = []
    for left, right in sorted(intervals, reverse=True):
        if merged and merged[-1][1] - left < gap:
            merged[-1] = (merged[-1][0], min(right, merged[-1][1]))
        else:
            merged.append((left, right))
    return merged


def drop_doubtful(lines: Lines) -> Lines:
    """Return ``lines`` with doubtful readings lost; unchanged where no reading was lost.

    Args:
        lines: Lines of a sweep with their headings, in any order.
    """
    if not any(np.any(line.codes == LOST) for line, _ in lines):
        return lines

    # Find the readings without one like them
    order = sorted(range(len(lines)), key=lambda k: -float(lines[k][1][lines[k][1].size // 2]))
    ranges = np.array([lines[k][0].ranges for k in order])
    lonely = np.isfinite(ranges) & ~_has_like(ranges)

    # Drop them with those beside them
    dropped = list(lines)
    for row in np.flatnonzero(lonely.any(axis=1)):
        line, yaws = lines[order[row]]
        spans = np.convolve(lonely[row], np.ones(2 * DOUBTED_BEAMS + 1), mode="same") > 0.5
        dropped[order[row]] = (_lose(line, spans), yaws)
    return dropped


def fill_lost(image: RangeImage, config: GapConfig) -> RangeImage:
    """Return ``image`` with its lost readings filled like gaps, and ``UNMEASURED``.

    The floor is known to be free only where it was seen all along a line: without this, a lost row
    in each of many lines would close all ways.

    Args:
        image: Of a sweep in which readings may be ``LOST``.
        config: Its ``max_angle`` is that up to which holes were not scanned again.
    """
    lost = image.codes == LOST
    if not lost.any():
        return image
    ranges = np.where(lost, fill_gaps(image, config).ranges, image.ranges)
    codes = np.where(lost, UNMEASURED, image.codes)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))


def _has_like(ranges: FloatArray) -> BoolArray:
    """Return which readings (n, n_beams) have one like them in their neighbourhood."""
    k = NEIGHBOURHOOD
    padded = np.pad(ranges, k, constant_values=np.nan)
    found = np.zeros(ranges.shape, dtype=bool)
    for i, j in product(range(2 * k + 1), repeat=2):
        if (i, j) != (k, k):
            shifted = padded[i : i + ranges.shape[0], j : j + ranges.shape[1]]
            found |= np.abs(shifted - ranges) < LIKE
    return found


def _lose(line: ScanLine, lost: BoolArray) -> ScanLine:
    """Return ``line`` without the readings that are ``lost`` (n_beams,)."""
    return replace(
        line,
        ranges=read_only(np.where(lost, np.nan, line.ranges)),
        codes=read_only(np.where(lost, LOST, line.codes), np.int64),
    )
