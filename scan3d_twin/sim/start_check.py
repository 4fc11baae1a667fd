"""Whether the robot stands in its scene when time 0 comes, and if not, why.

A scene can leave no floor under the robot, put it into a thing, or let it slide. Driving on would
end late, in an error that blames the robot.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import Hazards
from scan3d_twin.sim.world import PREFIX, World

MAX_HEIGHT = 0.02
"""Largest height or depth of the base above the floor [m]; uneven floors reach 4 mm."""
MAX_TILT = np.radians(3.0)
"""Largest tilt [rad]; with a wheel in the largest dip of an uneven floor it is 1."""
MAX_SPEED = 0.02
"""Largest speed of the base [m/s]; on its suspension it is 1e-4."""
MAX_SHIFT = 0.02
"""Largest distance from the spawn [m]; settling moves the robot by less than a millimetre."""
MAX_DEPTH = 0.005
"""Largest depth to which a thing and the robot overlap [m]; contacts are soft by a tenth of it."""


def check_place(model: Any, name: str, spawn: tuple[float, float]) -> None:
    """Refuse a ``model`` in which the robot is put into a thing.

    Args:
        model: The scene with the robot.
        name: Name of the scene in messages.
        spawn: The place (x, y) [m] where the robot is put.

    Raises:
        SceneError: It is; the message names the thing.
    """
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    inside = [_other(model, each) for each in data.contact if each.dist < -MAX_DEPTH]
    things = ", ".join(sorted(set(inside) - {""}))
    if things:
        raise SceneError(
            f"scene {name}: {_describe(spawn)} is inside {things}; move the site 'spawn', which is "
            "where the robot starts, or the thing"
        )


def check_stand(world: World, name: str, spawn: tuple[float, float], hazards: Hazards) -> None:
    """Refuse a ``world`` in which the robot does not stand at rest on a floor at its ``spawn``.

    Args:
        world: The world at time 0.
        name: Name of the scene in messages.
        spawn: The place (x, y) [m] where the robot was put.
        hazards: What its safety sensors report.

    Raises:
        SceneError: It does not; the message names the cause.
    """
    # Measure how it stands
    body = world.data.body(PREFIX + "base")
    height, shift = float(body.xpos[2]), float(np.linalg.norm(body.xpos[:2] - spawn))
    tilt = float(np.arccos(np.clip(body.xmat[8], -1.0, 1.0)))
    address = int(world.model.joint(PREFIX + "free").dofadr[0])
    speed = float(np.linalg.norm(world.data.qvel[address : address + 3]))
    place = _describe(spawn)

    # Name the cause
    if height < -MAX_HEIGHT:
        raise SceneError(f"scene {name}: no solid floor carries the robot at {place}")
    if not (height <= MAX_HEIGHT and tilt <= MAX_TILT and shift <= MAX_SHIFT):
        under = _find_support(world.model, world.data)
        raise SceneError(
            f"scene {name}: at {place} the robot does not stand level on {under} (height "
            f"{1e3 * height:.0f} mm, tilt {np.degrees(tilt):.1f} deg, moved {1e3 * shift:.0f} mm); "
            "move the site 'spawn' to level floor"
        )
    if not speed <= MAX_SPEED:
        raise SceneError(
            f"scene {name}: the robot does not come to rest at {place}; it moves at {speed:.2g} m/s"
        )
    cliffs = [each for each in hazards.active() if "cliff" in each]
    if cliffs:
        raise SceneError(
            f"scene {name}: {place} is at the edge of the floor ({', '.join(cliffs)}); move the "
            "site 'spawn' or enlarge the floor"
        )


def _describe(spawn: tuple[float, float]) -> str:
    return f"the robot's start ({spawn[0]:.3g}, {spawn[1]:.3g})"


def _find_support(model: Any, data: Any) -> str:
    """Return the geoms of the scene that touch the robot."""
    touching = {_other(model, contact) for contact in data.contact} - {""}
    return ", ".join(sorted(touching)) or "any floor"


def _other(model: Any, contact: Any) -> str:
    """Return the scene's part of a contact with the robot; empty if it is none with the robot."""
    names = [_name(model, int(geom)) for geom in contact.geom]
    own = [name.startswith(PREFIX) for name in names]
    return names[own.index(False)] if any(own) and not all(own) else ""


def _name(model: Any, geom: int) -> str:
    """Return a geom's name, or that of the first named body above it."""
    body = int(model.geom_bodyid[geom])
    found: str = model.geom(geom).name
    if not found and model.body(body).name.startswith(PREFIX):
        return PREFIX
    while not found and body > 0:
        found, body = model.body(body).name, int(model.body_parentid[body])
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    return found or f"a {kind} without a name"
