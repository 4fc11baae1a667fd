"""Which sides of a mesh's faces count, whichever way they are wound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray

LEVEL_TOLERANCE = 2.0**-20
"""Difference of heights below which corners are level, in units of the extent: above the rounding
of single precision (2^-24)."""


def turn_over(triangles: FloatArray) -> FloatArray:
    """Return ``triangles`` (n, 3, 3) wound the other way, each from the same corner."""
    return triangles[:, [0, 2, 1]]


def start_lowest(triangles: FloatArray) -> FloatArray:
    """Return ``triangles`` (n, 3, 3), each from its lowest corner, wound as before.

    Of two that are level, it is the one that the other follows; level triangles stay as they are.
    """
    heights = triangles[:, :, 2]
    extent = float(np.ptp(heights)) if len(triangles) else 0.0
    lowest = heights <= heights.min(axis=1, keepdims=True) + extent * LEVEL_TOLERANCE
    followed = lowest & np.roll(lowest, -1, axis=1)
    first = np.where(lowest.sum(axis=1) == 1, lowest.argmax(axis=1), followed.argmax(axis=1))
    first[lowest.all(axis=1)] = 0
    corners = (first[:, None] + np.arange(3)) % 3
    result: FloatArray = np.take_along_axis(triangles, corners[:, :, None], axis=1)
    return result


@dataclass(frozen=True)
class Facing:
    """Which sides of a mesh's faces count.

    Attributes:
        flipped: Faces that are wound inwards (n_faces,).
        two_sided: Faces of open sheets (n_faces,).
        repeated: Faces that repeat another one (n_faces,).
    """

    flipped: BoolArray
    two_sided: BoolArray
    repeated: BoolArray

    def apply(self, triangles: FloatArray) -> FloatArray:
        """Return ``triangles`` (n_faces, 3, 3) wound outwards; those with two sides come twice.

        Samples on them do not depend on how the file winds them, if each begins with the corner of
        the least number.
        """
        triangles = np.where(self.flipped[:, None, None], turn_over(triangles), triangles)
        triangles = start_lowest(triangles)
        backs = turn_over(triangles[self.two_sided & ~self.repeated])
        return np.concatenate([triangles[~self.repeated], backs])

    def describe(self, name: str) -> str:
        """Return what was repaired in mesh ``name`` in one sentence; empty if nothing was."""
        total, parts = len(self.flipped), []
        for mask, text in (
            (self.flipped & ~self.repeated & ~self.two_sided, "wound inwards and were turned"),
            (self.two_sided & ~self.repeated, "part of an open sheet and count on both sides"),
            (self.repeated, "repeated and count once"),
        ):
            if mask.any():
                parts.append(f"{int(mask.sum())} of {total} faces are {text}")
        return f"Mesh {name}: {', '.join(parts)}." if parts else ""
