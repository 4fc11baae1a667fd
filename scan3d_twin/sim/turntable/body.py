"""The body of a turntable in the robot's MJCF: servo, axis, and the lidar that it carries."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.scanning.patterns import AXIS_HEIGHT, TableMount
from scan3d_twin.core.types import FloatArray

HINGE = "turntable"
"""Name of the joint, where it has one."""
CARRIED_SITE = "carried_lidar"
"""Name of the lidar's frame on the turntable; the site ``lidar`` is the frame ``axis`` then."""
HOUSING = (0.025, 0.035, 0.025)
"""Half sizes of the lidar's housing in its own frame [m], as in ``create2.xml``."""
SERVO = (0.010, 0.013, 0.017)
"""Half sizes of an XL330 [m]: 20 x 26 x 34 mm."""
HEAD_MASS = 0.30
"""Mass of the head [kg], as in ``create2.xml``; in the middle of the mast, as a counterweight
balances the lidar: else the mast, which is tuned to sway with it, leans by 0.7 deg. An
assumption."""
MIN_MASS = 1e-6
"""Mass that MuJoCo wants of what moves [kg]."""
POST = 0.010
"""Half the thickness of the post below the servo [m]; an assumption."""


def add_turntable(spec: Any, mount: TableMount, *, hinged: bool) -> None:
    """Put a turntable on the mast of the robot ``spec``, in the middle of its base.

    Args:
        spec: The robot's ``MjSpec``, changed in place.
        mount: Where the axis is, and the lidar on it.
        hinged: Whether it turns about a hinge. In the twin's physics it does not: it is light, and
            its motion is added to the pose of the axis (``World.lidar_poses``).
    """
    # Move mast and plate to the middle
    mast, plate = spec.body("mast"), spec.geom("mast_plate")
    mast.pos = [0.0, 0.0, mast.pos[2]]
    plate.pos, plate.size = [0.0, 0.0, plate.pos[2]], [POST, POST, plate.size[2]]
    spec.delete(spec.geom("lidar_housing"))

    # Place the axis
    T = mount.T_base_axis.copy()
    T[:3, 3] -= np.array([0.0, 0.0, mast.pos[2]])
    axis = spec.site("lidar")
    axis.pos, axis.quat = T[:3, 3], _quaternion(T)
    mast.add_geom(
        name="servo", type=mujoco.mjtGeom.mjGEOM_BOX, size=SERVO, mass=HEAD_MASS,
        pos=[0.0, 0.0, AXIS_HEIGHT - mast.pos[2]],
    )  # fmt: skip

    # Carry the lidar
    table = mast.add_body(name="turntable", pos=T[:3, 3], quat=_quaternion(T))
    if hinged:
        table.add_joint(name=HINGE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    lidar = mount.T_axis_lidar
    place = {"pos": lidar[:3, 3], "quat": _quaternion(lidar)}
    table.add_geom(
        name="lidar_housing", type=mujoco.mjtGeom.mjGEOM_BOX, size=HOUSING, mass=MIN_MASS, **place
    )
    table.add_site(name=CARRIED_SITE, **place)


def _quaternion(T: FloatArray) -> FloatArray:
    """Return the rotation of ``T`` (4, 4) as a quaternion w, x, y, z."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T[:3, :3]).ravel())
    return quaternion
