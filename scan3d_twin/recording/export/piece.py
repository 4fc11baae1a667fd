"""The input of all exporters: a cloud in its own frame, and the pose of that frame."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.recording.export.unit import PER_METRE, Unit


@dataclass(frozen=True, slots=True)
class Piece:
    """A cloud to be exported.

    Attributes:
        name: Name of its file, without suffix.
        model: Points and normals in the piece's own frame.
        T_world_piece: Pose of that frame in ``world``.
        unit: Of all lengths: m unless the user asked for millimetres.
    """

    name: str
    model: Model
    T_world_piece: Pose2
    unit: Unit = "m"

    def in_unit(self, unit: Unit) -> Piece:
        """Return the same piece with its lengths in ``unit``."""
        scale = PER_METRE[unit] / PER_METRE[self.unit]
        model, pose = self.model, self.T_world_piece
        return Piece(
            self.name,
            replace(model, points=scale * model.points, sigma=scale * model.sigma),
            Pose2(scale * pose.x, scale * pose.y, pose.yaw),
            unit,
        )


def point_lines(points: FloatArray, form: str) -> bytes:
    """Return ``points`` (n, 3) as lines of text, each number by the format ``form``."""
    buffer = io.BytesIO()
    np.savetxt(buffer, points, fmt=form)
    return buffer.getvalue()


def poses_csv(parts: Sequence[Piece]) -> str:
    """Return where each part's frame is in ``world``, in its unit and [rad]."""
    unit = parts[0].unit if parts else "m"
    rows = [f"name,x_{unit},y_{unit},yaw_rad"]
    for part in parts:
        pose = part.T_world_piece
        rows.append(f"{part.name},{pose.x:.6f},{pose.y:.6f},{pose.yaw:.8f}")
    return "\n".join(rows) + "\n"
