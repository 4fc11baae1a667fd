"""PLY: what ``model.ply`` holds, of any piece and in its unit."""

from __future__ import annotations

from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.recording.export.unit import NAMES
from scan3d_twin.recording.ply import model_ply


def encode(piece: Piece) -> bytes:
    """Return ``piece`` as a PLY file."""
    return model_ply(piece.model, NAMES[piece.unit])


PLY = CloudFormat(suffix=".ply", encode=encode)
