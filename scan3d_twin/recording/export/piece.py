"""What the exporters write: a cloud in its own frame, and where that frame is."""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import Pose2


@dataclass(frozen=True, slots=True)
class Piece:
    """A cloud to be written.

    Attributes:
        name: Of its file, without suffix.
        model: The points and normals in its own frame.
        T_world_piece: Where that frame is.
    """

    name: str
    model: Model
    T_world_piece: Pose2
