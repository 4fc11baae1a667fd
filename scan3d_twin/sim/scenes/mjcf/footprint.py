"""Whether the robot stands free at a place: by contacts, and by level rays all round."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import FloatArray
from scan3d_twin.sim.ray_casting import RayCaster
from scan3d_twin.sim.scenes.mjcf.floors import ROBOT_HEIGHT
from scan3d_twin.sim.scenes.mjcf.settings import reset_contact

RADIUS = 0.165 + 0.10
"""Free radius around the start [m]: the robot's and a turn's clearance."""
MAX_STEP = 0.005
"""Height of what the robot drives over [m]; assumption."""
HEIGHTS = (0.05, 0.15, LIDAR_HEIGHT)
"""Heights of level rays [m]."""
DIRECTIONS = 120
"""Number of level rays at each height: 14 mm apart at the robot's clearance."""


class Footprint:
    """A cylinder as high as the robot, and as wide with its clearance, to be put anywhere.

    Contacts are MuJoCo's, so that meshes are as solid as for the robot: filled up to their convex
    hulls. What is drawn without contacts is met by rays.
    """

    def __init__(self, spec: Any, caster: RayCaster, qpos: FloatArray) -> None:
        """Add the cylinder to a copy of ``spec``; ``caster`` looks at its scene at ``qpos``."""
        # Add the cylinder on a free joint
        half = (ROBOT_HEIGHT - MAX_STEP) / 2
        copy = spec.copy()
        body = copy.worldbody.add_body()
        body.add_freejoint()
        cylinder = body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[RADIUS, half, 0], mass=1.0
        )
        reset_contact(cylinder)

        # Compile it
        self._model = copy.compile()
        self._data = mujoco.MjData(self._model)
        self._geom = self._model.ngeom - 1  # the last body of the world
        self._height = MAX_STEP + half
        self._caster, self._qpos = caster, qpos

    def is_free(self, place: FloatArray) -> bool:
        """Return whether nothing is within ``RADIUS`` of ``place`` (2,) [m] on floor at z = 0."""
        # Touch
        self._data.qpos[-7:] = [*place, self._height, 1, 0, 0, 0]
        mujoco.mj_fwdPosition(self._model, self._data)
        if any(self._geom in each.geom and each.dist < 0 for each in self._data.contact):
            return False

        # Look around
        angles = math.tau * np.arange(DIRECTIONS) / DIRECTIONS
        level = np.stack([np.cos(angles), np.sin(angles), np.zeros(DIRECTIONS)], axis=1)
        rays = np.tile(level, (len(HEIGHTS), 1))
        heights = np.repeat(HEIGHTS, DIRECTIONS)
        origins = np.column_stack([np.tile(place, (len(rays), 1)), heights])
        return bool((self._caster.cast(self._qpos, origins, rays).distances > RADIUS).all())
