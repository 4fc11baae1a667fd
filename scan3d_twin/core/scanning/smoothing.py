"""Smoothing of a range image: the surface behind the noise, for simulated scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from scan3d_twin.core.types import RangeImage, read_only

WINDOW = 5
"""Readings in each direction over which is averaged: 25 of them leave a fifth of the noise."""
DEPTH_EDGE = 0.10
"""A window whose readings differ by more lies across a depth edge and is left as it is [m]."""


def smooth(image: RangeImage) -> RangeImage:
    """Return ``image`` with the inverse of its ranges averaged over small windows.

    On a plane the inverse range is a linear function of the beam direction (Badino et al., ICRA
    2011), so that the average over a symmetric window does not move it. Windows across a depth edge
    or with missing readings keep the reading in their middle.
    """
    ranges = image.ranges
    valid = np.isfinite(ranges)
    far, near = np.where(valid, ranges, np.inf), np.where(valid, ranges, -np.inf)
    farthest = ndimage.maximum_filter(far, WINDOW, mode="constant", cval=np.inf)
    nearest = ndimage.minimum_filter(near, WINDOW, mode="constant", cval=-np.inf)
    whole = farthest - nearest < DEPTH_EDGE
    inverse = np.divide(1.0, ranges, out=np.zeros_like(ranges), where=valid)
    mean = ndimage.uniform_filter(inverse, WINDOW)
    smoothed = np.divide(1.0, mean, out=ranges.copy(), where=whole)
    return replace(image, ranges=read_only(smoothed))
