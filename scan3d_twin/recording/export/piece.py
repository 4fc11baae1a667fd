"""The input of all exporters: a cloud in its own frame, and the pose of that frame."""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import Pose2


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
