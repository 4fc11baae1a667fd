"""PLY (Turk, 1994), binary: points with normals, colour and index of the view."""

from __future__ import annotations

import numpy as np

from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece

_VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [("view", "<i4")]
)
_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def encode(piece: Piece) -> bytes:
    """Return ``piece`` as a PLY file."""
    # Fill the vertices
    model = piece.model
    vertices = np.empty(len(model), dtype=_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = model.points[:, axis]
        vertices["n" + name] = np.nan_to_num(model.normals[:, axis])
    vertices["view"] = model.view
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = view_colours_rgb(model.view)[:, channel]

    # Write the header
    names = _VERTEX.names or ()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment scan3d_twin: metres",
        f"element vertex {len(model)}",
        *(f"property {_TYPES[_VERTEX[name].str]} {name}" for name in names),
        "end_header",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes()


PLY = CloudFormat(suffix=".ply", encode=encode)
