"""Free space of a point cloud: the range to the nearest point in every direction.

A cloud seen from its origin shows that its rays are free up to their points. What another cloud
has in front of them contradicts it, as a surfel does in ``free_space``, which asks the readings of
a sweep. Where a cloud has several viewpoints, or none as a sampled mesh, it contradicts itself; the
share by which it does is deducted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

AZIMUTHS, ELEVATIONS = 120, 60
"""Bins of a panorama: 3 deg each, the spacing of the rings of a coarse spinning lidar."""
MOST_POINTS = 5000
"""A panorama is made of this many points at most."""
RANGE_MARGIN = 0.02
"""Relative distance in front of the nearest point that is not yet a contradiction."""


@dataclass(frozen=True)
class Panorama:
    """Ranges by azimuth and elevation.

    Attributes:
        nearest: Least range in each bin and its eight neighbours (AZIMUTHS, ELEVATIONS) [m].
        filled: Whether the bin itself has a point (AZIMUTHS, ELEVATIONS).
    """

    nearest: FloatArray
    filled: BoolArray

    @staticmethod
    def of(points: FloatArray) -> Panorama:
        """Return the panorama of ``points`` (n, 3) [m] seen from their origin."""
        ranges, azimuth, elevation = _find_bins(points[:: max(1, len(points) // MOST_POINTS)])
        image = np.full((AZIMUTHS + 2, ELEVATIONS + 2), np.inf)
        np.minimum.at(image, (azimuth + 1, elevation + 1), ranges)
        image[0], image[-1] = image[-2], image[1]  # azimuths go round
        around = np.minimum(np.minimum(image[:-2], image[1:-1]), image[2:])
        nearest = np.minimum(np.minimum(around[:, :-2], around[:, 1:-1]), around[:, 2:])
        return Panorama(nearest, np.isfinite(image[1:-1, 1:-1]))

    def contradiction(self, points: FloatArray, margin: float) -> float:
        """Return the share of ``points`` (n, 3) [m] in front of what was seen there, 0..1.

        Args:
            points: Surface points of another cloud, in this one's frame.
            margin: Distance that is not yet a contradiction [m].
        """
        ranges, azimuth, elevation = _find_bins(points)
        seen = self.filled[azimuth, elevation]
        limit = (1.0 - RANGE_MARGIN) * self.nearest[azimuth, elevation] - margin
        before = int(np.count_nonzero(seen & (ranges < limit)))
        return before / max(1, int(np.count_nonzero(seen)))


def _find_bins(points: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    """Return ranges (n,) [m] and the bins of azimuth and elevation (n,) of ``points`` (n, 3)."""
    x, y, z = points.T
    flat = np.hypot(x, y)
    azimuth = (np.arctan2(y, x) / math.tau + 0.5) * AZIMUTHS
    elevation = (np.arctan2(z, flat) / math.pi + 0.5) * ELEVATIONS
    return (
        np.hypot(flat, z),
        np.minimum(azimuth.astype(np.int64), AZIMUTHS - 1),
        np.minimum(elevation.astype(np.int64), ELEVATIONS - 1),
    )
