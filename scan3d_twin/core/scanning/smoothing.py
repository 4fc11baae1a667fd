"""Smoothing of a range image: the surface behind the noise, for simulated scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from scan3d_twin.core.types import RangeImage, read_only

WINDOW = 5
"""Side of the averaging window in readings: the mean of 25 has a fifth of the noise."""
DEPTH_EDGE = 0.10
"""Spread of the readings of a window above which it is across a depth edge and not averaged [m]."""


def smooth(image: RangeImage) -> RangeImage:
    """Return ``image`` with the inverse of its ranges averaged over small windows.

    On a plane the inverse range is a linear function of the beam direction (Badino et al., ICRA
    2011), so that the average over a symmetric window does not move the plane. Readings whose
    window is across a depth edge or incomplete stay as they are.
    """
    # Find windows on one surface
    ranges = image.ranges
    valid = np.isfinite(ranges)
    far, near = np.where(valid, ranges, np.inf), np.where(valid, ranges, -np.inf)
    farthest = ndimage.maximum_filter(far, WINDOW, mode="constant", cval=np.inf)
    nearest = ndimage.minimum_filter(near, WINDOW, mode="constant", cval=-np.inf)
    whole = farthest - nearest < DEPTH_EDGE

    # Average the inverse ranges
    inverse = np.divide(1.0, ranges, out=np.zeros_like(ranges), where=valid)
    mean = ndimage.uniform_filter(inverse, WINDOW)
    smoothed = np.divide(1.0, mean, out=ranges.copy(), where=whole)
    return replace(image, ranges=read_only(smoothed))
