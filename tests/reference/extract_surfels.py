"""Extraction of surfels and noise from a sweep, in NumPy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from reference.scan_arrays import Beams
from reference.scan_noise import estimate_noise
from reference.surfels import fit_surfels
from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray, SmallIntArray

WINDOWS = tuple(math.radians(angle) for angle in (2.1, 1.45, 0.85, 0.0))
"""Half sizes of the windows along lines and beams [rad]; at least one reading to each side."""
MOST_HALF = 12
"""Largest half size of a window in readings."""


class Swept(NamedTuple):
    """A sweep as arrays.

    Attributes:
        ranges: (n_lines, n_beams) [m].
        yaws: Of the base at each beam (n_lines, n_beams) [rad].
        codes: ``VALID`` for distances (n_lines, n_beams).
        beams: Of the lidar.
    """

    ranges: FloatArray
    yaws: FloatArray
    codes: IntArray
    beams: Beams


class ScanSurfels(NamedTuple):
    """The surfels of a sweep and its noise.

    Attributes:
        rows: Surfels (m, 8), columns as in ``surfels``, line by line.
        yaws: At which each was measured, from the middle of its even part (m,) [rad].
        row_of: Row of each reading (n_lines, n_beams), -1 where there is no surfel.
        valid: Readings that are distances (n_lines, n_beams).
        noise: Range sigma at 0 [m], its growth per metre, the sigma of a line's yaw [rad] and the
            factor for correlated beams (4,).
        line_spacing: Typical angle between two lines [rad].
    """

    rows: FloatArray
    yaws: FloatArray
    row_of: SmallIntArray
    valid: BoolArray
    noise: FloatArray
    line_spacing: float


def extract_surfels(swept: Swept, keep: BoolArray, noise: FloatArray) -> ScanSurfels:
    """Return the surfels and the noise of a sweep.

    Only the part from the first to the last line and beam with a reading is used.

    Args:
        swept: The sweep.
        keep: Readings (n_lines, n_beams) that get a surfel; (0, 0) for all.
        noise: As in ``ScanSurfels``, NaN where it is to be estimated (4,).
    """
    valid = (swept.codes == VALID) & (swept.ranges > 0) & (swept.ranges < np.inf)
    l0, l1 = extent(np.sum(valid, axis=1))
    b0, b1 = extent(np.sum(valid, axis=0))
    ranges, yaws = swept.ranges[l0:l1, b0:b1], swept.yaws[l0:l1, b0:b1]
    part = valid[l0:l1, b0:b1]
    wanted = part & keep[l0:l1, b0:b1] if keep.size > 0 else part.copy()
    beams = swept.beams.directions[b0:b1]
    noise = np.where(np.isnan(noise), estimate_noise(ranges, yaws, part), noise)
    middles = swept.yaws[:, swept.yaws.shape[1] // 2].copy()
    line_spacing = np.median(np.abs(np.diff(middles)))
    windows = half_sizes(line_spacing, swept.beams.spacing)
    lever = swept.beams.lever
    rows, of_rows, found = fit_surfels(ranges, yaws, beams, lever, part, wanted, noise, windows)
    row_of = np.full(valid.shape, -1, dtype=np.int32)
    row_of[l0:l1, b0:b1] = found
    reach = min(np.max(middles), -np.min(middles)) + 1.5 * line_spacing
    even = middles[np.abs(middles) <= reach] if reach > 0 else middles
    of_rows -= np.mean(even)
    return ScanSurfels(rows, of_rows, row_of, valid, noise, line_spacing)


def half_sizes(line_spacing: float, beam_spacing: float) -> IntArray:
    """Return the half sizes of the windows in lines and beams (4, 2), largest first."""
    sizes = np.empty((len(WINDOWS), 2), dtype=np.int64)
    for k in range(len(WINDOWS)):
        sizes[k, 0] = min(MOST_HALF, max(1, round(WINDOWS[k] / max(line_spacing, 1e-4))))
        sizes[k, 1] = min(MOST_HALF, max(1, round(WINDOWS[k] / max(beam_spacing, 1e-4))))
    return sizes


def extent(counts: IntArray) -> tuple[int, int]:
    """Return the first place where ``counts`` (n,) is not 0, and the end; 0 and 1 if none is."""
    used = np.flatnonzero(counts)
    return (used[0], used[-1] + 1) if len(used) > 0 else (0, 1)
