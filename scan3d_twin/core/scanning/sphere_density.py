"""Density of a sweep over the sphere of directions: each pattern is densest about its own axis.

The sphere is cut into cells of equal solid angle: columns of azimuth, rows of equal steps of the
sine of the elevation. Readings without a return count too: they have looked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import UNMEASURED, RangeImage

COLUMNS, ROWS = 72, 36
"""Cells of the sphere: 5 deg of azimuth, and 16 square degrees each."""
SQUARE_DEGREES = 4 * math.pi * math.degrees(1.0) ** 2
"""Solid angle of the whole sphere [deg2]."""


@dataclass(frozen=True, slots=True)
class SphereDensity:
    """How dense the readings of a sweep are over the sphere.

    Attributes:
        seen: Share of the sphere in which there are readings.
        low: Readings per square degree in the sparsest tenth of that, at most [1/deg2].
        median: The same in half of it.
        high: The same in all of it but the densest tenth.
    """

    seen: float
    low: float
    median: float
    high: float


def measure_density(image: RangeImage) -> SphereDensity:
    """Return the density of the readings of ``image`` over the sphere of directions."""
    rays = image.directions[image.codes != UNMEASURED]
    column = ((np.arctan2(rays[:, 1], rays[:, 0]) / math.tau) % 1.0 * COLUMNS).astype(np.int64)
    row = ((np.clip(rays[:, 2], -1.0, 1.0) + 1) / 2 * ROWS).astype(np.int64)
    cells = np.minimum(column, COLUMNS - 1) * ROWS + np.minimum(row, ROWS - 1)
    counts = np.bincount(cells, minlength=COLUMNS * ROWS)
    seen = counts[counts > 0] * (COLUMNS * ROWS / SQUARE_DEGREES)
    if len(seen) == 0:
        return SphereDensity(0.0, 0.0, 0.0, 0.0)
    low, median, high = (float(each) for each in np.quantile(seen, [0.1, 0.5, 0.9]))
    return SphereDensity(len(seen) / len(counts), low, median, high)
