"""The true poses of the base over the whole run, for evaluation; the world keeps half a minute."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import FloatArray, wrap_all
from scan3d_twin.sim.world import HISTORY_STEPS, World, interpolate

POSE_COLUMNS = 7
"""Columns of a pose: position and quaternion."""


class PoseTrace:
    """The true poses of the base since the start; a ``Device`` of the clock.

    Attributes:
        next_step: See ``Device``: due well before the world discards poses.
    """

    def __init__(self, world: World) -> None:
        self.next_step = HISTORY_STEPS // 2
        self._world = world
        self._rows = np.empty((1024, POSE_COLUMNS))
        self._kept = 0

    def service(self) -> None:
        """Copy the poses of the steps since the last call."""
        steps = self._world.steps
        if steps >= len(self._rows):
            grown = np.empty((2 * (steps + 1), POSE_COLUMNS))
            grown[: self._kept] = self._rows[: self._kept]
            self._rows = grown
        fresh = np.arange(self._kept, steps + 1)
        self._rows[fresh] = self._world.base_rows(fresh)
        self._kept = steps
        self.next_step = steps + HISTORY_STEPS // 2

    def scene_qpos(self) -> FloatArray:
        """Return the positions of the scene's moving objects."""
        return self._world.scene_qpos()

    @property
    def latest(self) -> float:
        """Time of the latest pose [s]."""
        self.service()
        return self._kept * self._world.timestep

    def base_poses(self, times: FloatArray) -> FloatArray:
        """Return x, y [m] and yaw [rad] (n, 3) of ``T_map_base`` at ``times`` (n,) [s].

        They are interpolated, clamped to the recorded times.
        """
        self.service()
        rows = interpolate(self._rows.__getitem__, times / self._world.timestep, 0, self._kept + 1)
        x, y, _, qw, qx, qy, qz = rows.T
        yaw = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
        return np.stack([x, y, wrap_all(yaw)], axis=1)
