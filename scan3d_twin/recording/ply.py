"""Point clouds as binary PLY, readable by any viewer."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray

_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("view", "<i4")])


def ply_bytes(points: FloatArray, view: IntArray) -> bytes:
    """Return ``points`` (n, 3) [m], each with the index of its ``view`` (n,), as a PLY file."""
    # Fill the vertices
    vertices = np.empty(len(points), dtype=_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[:, axis]
    vertices["view"] = view

    # Write the header
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment scan3d_twin: metres, frame world",
        f"element vertex {len(points)}",
        "property float x",
        "property float y",
        "property float z",
        "property int view",
        "end_header",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes()
