"""Which sides of a mesh's faces count, whichever way they are wound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray


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
        """Return ``triangles`` (n_faces, 3, 3) wound outwards; those with two sides come twice."""
        triangles = np.where(self.flipped[:, None, None], triangles[:, ::-1], triangles)
        backs = triangles[self.two_sided & ~self.repeated][:, ::-1]
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
