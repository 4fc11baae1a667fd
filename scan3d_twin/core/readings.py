"""The readings of a sweep that are wanted, as points; ``native/readings.h`` places them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, RangeImage, read_only


class Placed(NamedTuple):
    """Some readings of a sweep, sorted by line.

    Attributes:
        points: In ``scan`` (n, 3) [m], as ``RangeImage.points`` has them.
        lines: Of each (n,), ascending.
        beams: Of each (n,).
        distance: From the axis of the base (n,) [m].
    """

    points: FloatArray
    lines: IntArray
    beams: IntArray
    distance: FloatArray

    @staticmethod
    def of(image: RangeImage, wanted: BoolArray) -> Placed:
        """Return the readings of ``image`` that are ``wanted`` (n_lines, n_beams)."""
        index = np.flatnonzero(wanted)
        yaws, n = image.yaws.take(index), len(index)
        placed = Placed(np.empty((n, 3)), np.empty(n, int), np.empty(n, int), np.empty(n))
        engine.placed(
            index, n, image.spec.n_beams, read_only(image.ranges), np.cos(yaws), np.sin(yaws),
            np.ascontiguousarray(image.beams), read_only(image.T_base_lidar[:3, 3]), *placed,
        )  # fmt: skip
        return placed
