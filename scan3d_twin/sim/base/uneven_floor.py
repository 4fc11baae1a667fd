"""An uneven floor under the wheels, in place of the planes of a scene.

The lidar still sees the plane; the difference of a millimetre is below its noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.scenes.mjcf.floors import HIDDEN_GROUP, free_name
from scan3d_twin.sim.scenes.mjcf.settings import reset_contact

HALF_SIDE = 6.0
"""Half the side of the uneven square around the scene's origin [m]; the floor beyond is even."""
CELLS_PER_LENGTH = 4
"""Grid cells per ``uneven_length``; a coarser grid would have kinks."""


def draw_uneven_floor(config: RobotErrorConfig, rng: np.random.Generator) -> FloatArray:
    """Return random heights (n, n) [m] of zero mean with the correlation ``uneven_length``."""
    from scipy.ndimage import gaussian_filter  # slow to import

    n = round(2 * HALF_SIDE / config.uneven_length * CELLS_PER_LENGTH)
    smooth = gaussian_filter(rng.standard_normal((n, n)), CELLS_PER_LENGTH / 2, mode="nearest")
    heights: FloatArray = (smooth - smooth.mean()) / smooth.std() * config.uneven
    return heights


def lay_floor(spec: Any, heights: FloatArray, floors: Sequence[str]) -> None:
    """Let the robot roll on ``heights`` (n, n) [m] instead of the scene's planes at z = 0.

    Args:
        spec: The scene with the robot; changed in place.
        heights: Heights of the uneven floor [m].
        floors: Names of the planes; a floor made of boxes has its own edges.
    """
    # Disable contacts of the planes
    if not floors:
        return
    for name in floors:
        spec.geom(name).conaffinity = 0  # the robot touches what has a conaffinity

    # Add a height field instead
    low, high = float(heights.min()), float(heights.max())
    name = free_name(spec, "uneven_floor")
    field = spec.add_hfield(
        name=name,
        size=[HALF_SIDE, HALF_SIDE, high - low, 0.1],
        nrow=heights.shape[0],
        ncol=heights.shape[1],
    )
    field.userdata = ((heights - low) / (high - low)).ravel()

    # Hide it from the rays
    geom = spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=[0, 0, low],
        rgba=[0, 0, 0, 0],  # rays pass through what is wholly transparent
    )
    reset_contact(geom)
    geom.group = HIDDEN_GROUP
