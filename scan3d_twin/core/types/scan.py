"""The points of a sweep by their lines and beams."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.compression import CompressedArray, compressible, is_compressed
from scan3d_twin.core.types.arrays import BoolArray, FloatArray, IntArray
from scan3d_twin.core.types.range_image import RangeImage


@compressible("points", "lines", "beams")
@dataclass(frozen=True, eq=False)
class Scan3D:
    """Points of one sweep in frame ``scan``, sorted by line, left to right.

    Attributes:
        points: (n, 3) [m].
        lines: Index of each point's line in its range image (n,), ascending.
        beams: Index of each point's beam (n,).
        n_lines: Number of lines of that range image.

    >>> scan = session.views[0].target
    >>> scan.points.shape == (len(scan), 3)
    True
    >>> len(scan.last_lines(10).occupied_lines)  # the paper's Q for n_Q = 10
    10
    """

    points: FloatArray
    lines: IntArray
    beams: IntArray
    n_lines: int

    def __len__(self) -> int:
        return len(self.points)

    def compress(self, image: RangeImage) -> None:
        """Compress the arrays, which are seldom read.

        Points that equal those of ``image`` are computed from it from then on.
        """
        if is_compressed(self, "points"):
            return
        lines, beams = CompressedArray.of(self.lines), CompressedArray.of(self.beams)
        placed = _PointsOf(image, lines, beams)
        if np.array_equal(placed.decompress(), self.points):
            for name, compressed in (("points", placed), ("lines", lines), ("beams", beams)):
                object.__setattr__(self, name, compressed)

    @cached_property
    def occupied_lines(self) -> IntArray:
        """Indices of the lines that hold at least one point, ascending: the paper's l_1 .. l_n."""
        return np.flatnonzero(np.bincount(self.lines))

    def with_points_of(self, image: RangeImage) -> Scan3D:
        """Return the scan with its points taken from another ``image`` of the same sweep."""
        lines, beams = self.lines, self.beams
        return Scan3D(image.points_at(lines, beams), lines, beams, self.n_lines)

    def select(self, mask: BoolArray) -> Scan3D:
        """Return the points where ``mask`` (n,) is True."""
        kept = np.flatnonzero(mask)
        points = self.points.take(kept, axis=0)
        return Scan3D(points, self.lines.take(kept), self.beams.take(kept), self.n_lines)

    def first_lines(self, k: int) -> Scan3D:
        """Return the points of the first ``k`` occupied lines."""
        return self._lines_from(0, k)

    def middle_lines(self, k: int) -> Scan3D:
        """Return the points of the middle ``k`` occupied lines: Q' of eq. (5) when called on Q."""
        first = max(0, len(self.occupied_lines) - k) // 2
        return self._lines_from(first, k)

    def last_lines(self, k: int) -> Scan3D:
        """Return the points of the last ``k`` occupied lines: the paper's Q for k = n_Q."""
        first = max(0, len(self.occupied_lines) - k)
        return self._lines_from(first, k)

    def _lines_from(self, first: int, k: int) -> Scan3D:
        """Return the points of ``k`` occupied lines from the ``first`` one."""
        wanted = self.occupied_lines[first : first + k]
        if len(wanted) == 0:
            return self.select(np.zeros(len(self), dtype=bool))
        return self.select((self.lines >= wanted[0]) & (self.lines <= wanted[-1]))


@dataclass(frozen=True, slots=True)
class _PointsOf:
    """The points of an image at ``lines`` and ``beams``."""

    image: RangeImage
    lines: CompressedArray
    beams: CompressedArray

    def decompress(self) -> FloatArray:
        """Return the points (n, 3) [m], read-only."""
        points = self.image.points_at(self.lines.decompress(), self.beams.decompress())
        points.flags.writeable = False
        return points
