"""The input of all exporters: a cloud in its own frame, and the pose of that frame."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import FloatArray, Pose2


@dataclass(frozen=True, slots=True)
class Piece:
    """A cloud to be exported.

    Attributes:
        name: Name of its file, without suffix.
        model: Points and normals in the piece's own frame.
        T_world_piece: Pose of that frame in ``world``.
    """

    name: str
    model: Model
    T_world_piece: Pose2


def point_lines(points: FloatArray, form: str) -> bytes:
    """Return ``points`` (n, 3) as lines of text, each number by the format ``form``."""
    buffer = io.BytesIO()
    np.savetxt(buffer, points, fmt=form)
    return buffer.getvalue()


def poses_csv(parts: Sequence[Piece]) -> str:
    """Return where each part's frame is in ``world``, [m] and [rad]."""
    rows = ["name,x_m,y_m,yaw_rad"]
    for part in parts:
        pose = part.T_world_piece
        rows.append(f"{part.name},{pose.x:.6f},{pose.y:.6f},{pose.yaw:.8f}")
    return "\n".join(rows) + "\n"
