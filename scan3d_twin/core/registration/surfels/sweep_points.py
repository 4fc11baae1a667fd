"""Selected readings of a sweep as points; ``native/readings.h`` computes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, RangeImage, read_only


class SweepPoints(NamedTuple):
    """Points of some readings of a sweep, sorted by line.

    Attributes:
        points: Points in ``scan`` (n, 3) [m], as in ``RangeImage.points``.
        lines: Line of each point (n,), ascending.
        beams: Beam of each point (n,).
        distance: Distance from the yaw axis of the base (n,) [m].
    """

    points: FloatArray
    lines: IntArray
    beams: IntArray
    distance: FloatArray

    @staticmethod
    def of(image: RangeImage, wanted: BoolArray) -> SweepPoints:
        """Return the points of the readings of ``image`` that are ``wanted`` (n_lines, n_beams)."""
        index = np.flatnonzero(wanted)
        yaws, n = image.yaws.take(index), len(index)
        placed = SweepPoints(np.empty((n, 3)), np.empty(n, int), np.empty(n, int), np.empty(n))
        engine.place_readings(
            index, n, image.spec.n_beams, read_only(image.ranges), np.cos(yaws), np.sin(yaws),
            np.ascontiguousarray(image.beams), image.elevations is not None,
            read_only(image.T_base_lidar[:3, 3]), *placed,
        )  # fmt: skip
        return placed
