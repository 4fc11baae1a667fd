"""Mixed pixels: readings of a beam that fell on two surfaces, one behind the other.

They hang in the air between the two (Tang, Huber and Akinci, 3DIM 2007) and would lengthen a target
at its silhouette. A reading is taken for one when the range runs through it from the nearer surface
to the farther one in two steps, each steeper than any surface that a lidar still measures.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import MIXED, RangeImage, read_only

STEEPEST = math.radians(80.0)
"""Incidence from which on a UBG-04LX-F01 returns gross errors: steeper steps are no surface."""
NOISE = 0.04
"""What two readings of the same place may differ by [m]; 4 sigma at 4 m."""


def without_mixed_pixels(image: RangeImage, config: GapConfig) -> RangeImage:
    """Return ``image`` without its mixed pixels, along the lines and across them.

    Args:
        image: As it came from the robot.
        config: Steps up to ``depth_edge`` may be noise.
    """
    elevations, yaws = read_only(image.spec.elevations), read_only(image.yaws)
    mixed = np.zeros(image.ranges.shape, dtype=bool)
    engine.mark_mixed_pixels(
        read_only(image.ranges), elevations, yaws, *mixed.shape, config.depth_edge,
        math.tan(STEEPEST), mixed,
    )  # fmt: skip
    if not mixed.any():
        return image
    ranges = np.where(mixed, np.nan, image.ranges)
    codes = np.where(mixed, MIXED, image.codes)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))
