"""The truth of a run, known to the twin and to no planner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from scan3d_twin.core.types import FloatArray, Pose2


class Truth(Protocol):
    """The truth, known to the twin and to no planner; frame ``map`` is the simulator's world."""

    @property
    def spawn(self) -> Pose2:
        """Pose in ``map`` at which the robot was opened."""
        ...

    @property
    def front(self) -> Pose2 | None:
        """A pose on the target's front in ``map``, x along the outward normal, or None."""
        ...

    @property
    def latest(self) -> float:
        """Time until which the poses are known, on the clock of the robot [s]."""
        ...

    def pose_at(self, stamp: float) -> Pose2:
        """Return the base's true pose in ``map`` at ``stamp`` [s]."""
        ...

    def poses_at(self, stamps: FloatArray) -> FloatArray:
        """Return x, y [m] and yaw [rad] (n, 3) of the true poses at ``stamps`` (n,) [s]."""
        ...

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets."""
        ...

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return samples of the target's surface in ``map`` (n, 3) [m] and its normals (n, 3)."""
        ...

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the distance (n,) [m] to the first surface along each ray; inf for a miss."""
        ...

    def first_opaque_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the same through surfaces that light passes, as windows."""
        ...
