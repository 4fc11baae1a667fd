"""Gap filling (paper section 4.1): linear interpolation across missing readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.types import FloatArray, IntArray, RangeImage, read_only


def fill_gaps(image: RangeImage, config: GapConfig) -> RangeImage:
    """Return ``image`` with narrow gaps filled, first along each line, then across lines.

    A gap is filled when it is narrower than ``config.max_angle`` and the readings at its two ends
    differ by less than ``config.depth_edge``, so that no depth edge is bridged. Measured readings
    stay as they are; filled ones keep their error code.
    """
    columns = np.broadcast_to(image.spec.elevations, image.ranges.shape)
    ranges = _fill_rows(image.ranges, columns, config)
    ranges = _fill_rows(ranges.T, -image.yaws.T, config).T
    return replace(image, ranges=read_only(ranges))


def _fill_rows(ranges: FloatArray, angles: FloatArray, config: GapConfig) -> FloatArray:
    """Return ``ranges`` (m, n) with gaps along the rows filled.

    Args:
        ranges: Ranges, NaN in gaps (m, n) [m].
        angles: Angles, which rise along each row (m, n) [rad].
        config: Which gaps are filled.
    """
    # Find the readings around each gap
    valid = np.isfinite(ranges)
    columns = np.broadcast_to(np.arange(ranges.shape[1]), ranges.shape)
    before = _accumulate_max(np.where(valid, columns, -1))
    after = _accumulate_max(np.where(valid, -columns, -ranges.shape[1])[:, ::-1])[:, ::-1] * -1
    bounded = ~valid & (before >= 0) & (after < ranges.shape[1])
    row, column = np.nonzero(bounded)
    a, b = (row, before[bounded]), (row, after[bounded])

    # Interpolate across the narrow ones
    width = angles[b] - angles[a]
    narrow = (width <= config.max_angle) & (np.abs(ranges[b] - ranges[a]) <= config.depth_edge)
    share = (angles[row, column] - angles[a]) / np.where(width > 0, width, 1.0)
    filled = ranges.copy()
    filled[row[narrow], column[narrow]] = (ranges[a] + share * (ranges[b] - ranges[a]))[narrow]
    return filled


def _accumulate_max(values: IntArray) -> IntArray:
    """Return the running maximum along each row."""
    running: IntArray = np.maximum.accumulate(values, axis=1)
    return running
