"""PCD 0.7 of the Point Cloud Library, binary: points with normals, colour and index of the view."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.recording.colours import pack_rgb, view_colours_rgb
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.recording.export.unit import NAMES

_POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "normal_x", "normal_y", "normal_z")]
    + [("rgb", "<f4"), ("label", "<u4")]
)


def encode(piece: Piece) -> bytes:
    """Return ``piece`` as a PCD file, its pose as the file's viewpoint."""
    # Fill the points
    model, pose = piece.model, piece.T_world_piece
    points = np.empty(len(model), dtype=_POINT)
    for axis, name in enumerate("xyz"):
        points[name] = model.points[:, axis]
        points["normal_" + name] = model.normals[:, axis]
    # PCL reads the colour from the bits of a float; its pcd2ply loses that of an integer
    points["rgb"] = pack_rgb(view_colours_rgb(model.view))
    points["label"] = model.view

    # Write the header
    turn = f"{math.cos(pose.yaw / 2):.9g} 0 0 {math.sin(pose.yaw / 2):.9g}"
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# scan3d_twin: {NAMES[piece.unit]}",
        "VERSION 0.7",
        f"FIELDS {' '.join(_POINT.names or ())}",
        f"SIZE {' '.join(['4'] * 8)}",
        "TYPE F F F F F F F U",
        f"COUNT {' '.join(['1'] * 8)}",
        f"WIDTH {len(model)}",
        "HEIGHT 1",
        f"VIEWPOINT {pose.x:.9g} {pose.y:.9g} 0 {turn}",
        f"POINTS {len(model)}",
        "DATA binary",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + points.tobytes()


PCD = CloudFormat(suffix=".pcd", encode=encode)
