"""Smoothing of a range image: the surface behind the noise, for simulated scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d_twin.core.moving_windows import moving_maximum, moving_mean
from scan3d_twin.core.types import UNMEASURED, BoolArray, FloatArray, RangeImage, read_only

WINDOW = 5
"""Side of the averaging window in readings: the mean of 25 has a fifth of the noise."""
DEPTH_EDGE = 0.10
"""Spread of the readings of a window above which it is across a depth edge and not averaged [m]."""
MIN_SPREAD = 1e-8
"""Variance of the angles in a window below which they have no slope [rad2]: 0.006 deg."""


def smooth(image: RangeImage) -> RangeImage:
    """Return ``image`` with the inverse of its ranges averaged over small windows.

    On a plane the inverse range is a linear function of the beam direction (Badino et al., ICRA
    2011), so that the average over a symmetric window does not move the plane. Where lines have
    elevations of their own, windows are not symmetric, and the regression plane of the window over
    elevation and yaw is evaluated at the reading instead. Readings whose window is across a depth
    edge or incomplete stay as they are; places without a beam count as neither.
    """
    # Find windows on one surface
    ranges, own = image.ranges, image.elevations
    valid = np.isfinite(ranges)
    absent = ~valid & (image.codes == UNMEASURED) if own is not None else np.zeros_like(valid)
    far = np.where(valid, ranges, np.where(absent, -np.inf, np.inf))
    near = np.where(valid, ranges, np.where(absent, np.inf, -np.inf))
    farthest = moving_maximum(far, WINDOW)
    nearest = -moving_maximum(-near, WINDOW)
    whole = farthest - nearest < DEPTH_EDGE

    # Average the inverse ranges
    inverse = np.divide(1.0, ranges, out=np.zeros_like(ranges), where=valid)
    mean = _average(inverse) if own is None else _regress(inverse, (own, image.yaws), valid)
    smoothed = np.divide(1.0, mean, out=ranges.copy(), where=whole & valid)
    return replace(image, ranges=read_only(smoothed))


def _average(values: FloatArray) -> FloatArray:
    """Return the means (n_lines, n_beams) of ``values`` over the windows."""
    return moving_mean(moving_mean(values, WINDOW, axis=0), WINDOW, axis=1)


def _regress(
    values: FloatArray, angles: tuple[FloatArray, FloatArray], valid: BoolArray
) -> FloatArray:
    """Return the regression planes of ``values`` over the windows, each at its reading.

    Args:
        values: Inverse ranges (n_lines, n_beams).
        angles: Elevations and yaws (n_lines, n_beams).
        valid: Which of them count (n_lines, n_beams).
    """
    # Take moments over the windows
    weight, (e, y) = valid.astype(np.float64), angles
    total = np.maximum(_average(weight), 1.0 / WINDOW**2)

    def average(each: FloatArray) -> FloatArray:
        return np.asarray(_average(weight * each) / total)

    mean_e, mean_y, mean = average(e), average(y), average(values)
    ee, yy = average(e * e) - mean_e**2, average(y * y) - mean_y**2
    ey = average(e * y) - mean_e * mean_y
    ev, yv = average(e * values) - mean_e * mean, average(y * values) - mean_y * mean

    # Solve for the slopes, and evaluate the planes
    det = ee * yy - ey**2
    known = det > MIN_SPREAD**2
    det = np.where(known, det, 1.0)
    along, across = (yy * ev - ey * yv) / det, (ee * yv - ey * ev) / det
    tilt = along * (e - mean_e) + across * (y - mean_y)
    return np.asarray(mean + np.where(known, tilt, 0.0))
