"""What the inner loops need of a sweep, as tuples of arrays, which compiled code can take too."""

from __future__ import annotations

from typing import NamedTuple

from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.types import FloatArray, IntArray, SmallIntArray


class Target(NamedTuple):
    """The surfels of a sweep, found by the ray that sees a point.

    Attributes:
        rows: (m, 8), columns as in ``surfels``.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        row_of: Row of each reading (n_lines * n_beams,), or -1.
        projection: From a point to the reading that sees it.
    """

    rows: FloatArray
    yaws: FloatArray
    row_of: SmallIntArray
    projection: Projection


class Sample(NamedTuple):
    """Surfels taken from a sweep.

    Attributes:
        rows: (m, 8), columns as in ``surfels``, sorted by line.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        lines: Line of each (m,), ascending.
        stride: Each stands for ``stride`` squared readings.
    """

    rows: FloatArray
    yaws: FloatArray
    lines: IntArray
    stride: int
