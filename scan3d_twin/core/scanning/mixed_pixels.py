"""Removal of mixed pixels: readings of a beam that fell on two surfaces, one behind the other.

They hang in the air between the two surfaces (Tang, Huber and Akinci, 3DIM 2007) and would extend a
target at its silhouette. A reading counts as mixed when the range rises through it from the nearer
to the farther surface in two steps, each steeper than any surface that the lidar can measure.

Where the farther surface is out of range, nothing is read beside the silhouette. A lidar that
measures phases then places mixed pixels before the nearer surface as well as behind it, since its
phases repeat. A line of them 5 cm before a high edge makes a right match of two views that share
little look wrong. So the reading beside a line without one counts as mixed, too, where it is off
the plane of the next two.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import MIXED, RangeImage, read_only

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
    elevations, yaws = read_only(image.elevation_rows), read_only(image.yaws)
    mixed = np.zeros(image.ranges.shape, dtype=bool)
    engine.mark_mixed_pixels(
        read_only(image.ranges), elevations, len(elevations) > 1, yaws, *mixed.shape,
        config.depth_edge, math.tan(MAX_INCIDENCE), mixed,
    )  # fmt: skip
    if not mixed.any():
        return image
    ranges = np.where(mixed, np.nan, image.ranges)
    codes = np.where(mixed, MIXED, image.codes)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))
