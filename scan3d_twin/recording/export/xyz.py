"""XYZ: a point per line."""

from __future__ import annotations

from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece, point_lines


def encode(piece: Piece) -> bytes:
    """Return the points of ``piece`` as lines ``x y z`` [m], to a tenth of a millimetre."""
    return point_lines(piece.model.points, "%.4f")


XYZ = CloudFormat(suffix=".xyz", encode=encode)
