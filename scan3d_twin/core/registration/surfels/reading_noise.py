"""Noise of readings of surfaces that are seen frontally, to compare a sensor with its kind.

The noise that ``scan_noise`` estimates for registration is that of all readings of a sweep, and
depends on what is seen: it grows with range and incidence. Readings near the normal of their
surface and not far away have the noise that a log or a data sheet states.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.registration.surfels.extraction import N
from scan3d_twin.core.registration.surfels.grid import SurfelGrid
from scan3d_twin.core.types import read_only

RANGES = 0.5, 3.0
"""Ranges of the readings that count [m]: nearer the beam has no room to spread, farther returns are
weak. A log of a URG-04LX has 2.7 mm at 0.5 to 1 m and at 1 to 2 m, 4.7 mm at 3 to 4 m."""
MOST_INCIDENCE = math.radians(20.0)
"""Largest angle between ray and normal of readings that count [rad] (assumption)."""
MOST_SPACING = math.radians(1.5)
"""Largest angle between lines over which seven of them still show the noise of a surface and not
its shape: on three_boxes, lines .6, 1.2, 1.7, 2.2 and 2.9 deg apart read 1.13, 1.19, 1.25, 1.65
and 3.1 times the noise of the log."""
LEAST_READINGS = 100
"""Fewest readings that tell: they give the median of the differences to 10 % (assumption)."""
SIXTH_DIFFERENCE = read_only([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
"""Weights of seven lines, see ``scan_noise``; the sum of their squares is 924."""
MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute value."""


def measure_reading_noise(grid: SurfelGrid) -> float:
    """Return the standard deviation of the readings seen frontally in a sweep [m].

    It is 1.4826 median |D| r^2 / sqrt(924), with D the sixth difference of the inverse range over
    seven lines at one beam. NaN where too few readings are seen so, where lines are far apart, or
    where the beams of the lines lie at elevations of their own.
    """
    image = grid.image
    if image.elevations is not None or grid.line_spacing > MOST_SPACING:
        return math.nan

    # Choose near readings that have three lines on either side
    reach = len(SIXTH_DIFFERENCE) // 2
    ranges = image.ranges
    chosen = (grid.index >= 0) & (ranges > RANGES[0]) & (ranges < RANGES[1])
    chosen[:reach], chosen[-reach:] = False, False
    lines, beams = np.nonzero(chosen)

    # Keep those near the normal of their surface
    normals = grid.rows[grid.index[lines, beams], N]
    cosines = np.abs(np.sum(normals * image.directions_at(lines, beams), axis=1))
    frontal = cosines > math.cos(MOST_INCIDENCE)
    lines, beams = lines[frontal], beams[frontal]

    # Scale the differences to a standard deviation
    inverse = 1.0 / ranges
    difference = np.zeros(len(lines))
    for k, weight in enumerate(SIXTH_DIFFERENCE):
        difference += weight * inverse[lines + k - reach, beams]
    noise = np.abs(difference) * ranges[lines, beams] ** 2
    noise = noise[np.isfinite(noise)]
    if len(noise) < LEAST_READINGS:
        return math.nan
    weight = math.sqrt(float(SIXTH_DIFFERENCE @ SIXTH_DIFFERENCE))
    return MEDIAN_TO_SIGMA * float(np.median(noise)) / weight
