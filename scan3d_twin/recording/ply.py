"""Point clouds as binary PLY (Turk, 1994), with the names under which viewers look for values."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.recording.colours import view_colours_rgb

_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}
_XYZ = [(name, "<f4") for name in ("x", "y", "z")]
_POINT = np.dtype([*_XYZ, ("view", "<i4")])
_ORIENTED_POINT = np.dtype(
    [
        *_XYZ,
        *((name, "<f4") for name in ("nx", "ny", "nz")),
        *((name, "u1") for name in ("red", "green", "blue")),
        ("view", "<i4"),
        # The view once more, where CloudCompare (scalar_*) and MeshLab (quality) look for a scalar;
        # `intensity` is avoided, because MeshLab shows it instead of the colours.
        ("scalar_view", "<f4"),
        ("quality", "<f4"),
        ("scalar_sigma", "<f4"),
    ]
)


def model_ply(model: Model, *notes: str) -> bytes:
    """Return ``model`` as a PLY file: points with normals, colours, views, standard deviations.

    Unknown normals are zero. ``notes`` become comments: unit and frame.
    """
    vertices = np.empty(len(model), dtype=_ORIENTED_POINT)
    for axis, name in enumerate("xyz"):
        vertices[name] = model.points[:, axis]
        vertices["n" + name] = np.nan_to_num(model.normals[:, axis])
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = view_colours_rgb(model.view)[:, channel]
    for name in ("view", "scalar_view", "quality"):
        vertices[name] = model.view
    vertices["scalar_sigma"] = model.sigma
    return _encode(vertices, notes)


def ply_bytes(points: FloatArray, view: IntArray) -> bytes:
    """Return ``points`` (n, 3) [m], each with the index of its ``view`` (n,), as a PLY file."""
    vertices = np.empty(len(points), dtype=_POINT)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[:, axis]
    vertices["view"] = view
    return _encode(vertices, ("metres, frame world",))


def _encode(vertices: npt.NDArray[Any], notes: tuple[str, ...]) -> bytes:
    """Return the fields of the array ``vertices`` (n,) as the properties of the vertices."""
    names = vertices.dtype.names or ()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment scan3d_twin: {note}" for note in notes),
        f"element vertex {len(vertices)}",
        *(f"property {_TYPES[vertices.dtype[name].str]} {name}" for name in names),
        "end_header",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes()
