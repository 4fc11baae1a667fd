"""Removal of mixed pixels: readings of a beam that fell on two surfaces, one behind the other.

They hang in the air between the two surfaces (Tang, Huber and Akinci, 3DIM 2007) and would extend a
target at its silhouette. A reading counts as mixed when the range rises through it from the nearer
to the farther surface in two steps, each steeper than any surface that the lidar can measure.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.types import MIXED, BoolArray, FloatArray, RangeImage, read_only

MAX_INCIDENCE = math.radians(80.0)
"""Incidence above which a UBG-04LX-F01 returns gross errors: steeper steps are no surface [rad]."""
RANGE_NOISE = 0.04
"""Largest difference by noise of two readings of the same place [m]; 4 sigma at 4 m."""


def remove_mixed_pixels(image: RangeImage, config: GapConfig) -> RangeImage:
    """Return ``image`` without its mixed pixels, along the lines and across them.

    Args:
        image: The raw range image.
        config: Its ``depth_edge`` is the largest step that may be noise.
    """
    columns = np.broadcast_to(image.spec.elevations, image.ranges.shape)
    mixed = _is_mixed(image.ranges, columns, config.depth_edge)
    mixed |= _is_mixed(image.ranges.T, -image.yaws.T, config.depth_edge).T
    ranges = np.where(mixed, np.nan, image.ranges)
    codes = np.where(mixed, MIXED, image.codes)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))


def limit_surface_step(
    nearer: FloatArray, angle: FloatArray, noise: float = RANGE_NOISE
) -> FloatArray:
    """Return the largest difference of two readings of one surface [m].

    Args:
        nearer: The nearer of the two readings [m].
        angle: Angle between their beams [rad].
        noise: Largest difference by noise [m].
    """
    return np.asarray(np.maximum(noise, nearer * angle * math.tan(MAX_INCIDENCE)))


def _is_mixed(ranges: FloatArray, angles: FloatArray, noise: float) -> BoolArray:
    """Return which readings of each row (m, n) are between their neighbours, far from both."""
    rise = np.diff(ranges, axis=1)
    with np.errstate(invalid="ignore"):
        nearer = np.minimum(ranges[:, 1:], ranges[:, :-1])
        step = limit_surface_step(nearer, np.diff(angles, axis=1), noise)
        up, down = rise > step, rise < -step
    mixed = np.zeros(ranges.shape, dtype=bool)
    mixed[:, 1:-1] = (up[:, :-1] & up[:, 1:]) | (down[:, :-1] & down[:, 1:])
    return mixed
