"""The floor of a scene: the level surface under the robot's start, at z = 0 of ``map``.

* A floor is what a plumb line from the start meets first: a level plane, the top of a box, a mesh.
  Planes that are not level are walls, ramps or ceilings. Where there is no floor, one is added.
* A scene whose floor is raised or lowered is moved, so that ``map`` has z = 0 on the floor.
* A floor that is a plane is endless, as in MuJoCo's contacts. Its size is that of its picture,
  where rays end; so a floor whose picture ends where the robot drives is made endless for rays too.
* A wall, ramp or shelf that is a plane of finite size ends where its picture ends, for contacts
  too: MuJoCo takes all that is behind a plane for solid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import BoolArray, FloatArray
from scan3d_twin.sim.scenes.mjcf.settings import make_solid, reset_contact
from scan3d_twin.sim.scenes.visibility import is_visible

ROBOT_HEIGHT = 0.35
"""Height above which nothing can touch the robot [m]."""
MAX_FLOOR_DEPTH = 10.0
"""Largest depth at which a floor is looked for [m]; assumption."""
MIN_LEVEL_COSINE = np.cos(np.radians(0.5))
"""Least z of a level surface's normal; the robot's suspension evens out half a degree."""
HALF_THICKNESS = 0.01
"""Half the thickness of a plane that is no floor [m]; assumption."""
HIDDEN_GROUP = 3
"""Group of geoms that only contacts know."""
MAX_PASSED = 20
"""Largest number of surfaces that a plumb line passes on its way to the floor; assumption."""
HEIGHT_TOLERANCE = 1e-6
"""Height below which a floor counts as at z = 0 [m]."""
DRIVING_RANGE = 1.5
"""Distance around start and target within which the robot drives [m]: the standoff of 1 m and its
own diameter."""

_PLANE = mujoco.mjtGeom.mjGEOM_PLANE
_FLAT = (
    _PLANE,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_MESH,
    mujoco.mjtGeom.mjGEOM_HFIELD,
)
_GREY = [0.55, 0.55, 0.55, 1.0]
_DOWN = [0.0, 0.0, -1.0]


def name_planes(spec: Any) -> None:
    """Give names to the planes of ``spec`` that have none."""
    planes = [geom for geom in spec.geoms if geom.type == _PLANE]
    for number, plane in enumerate(planes):
        plane.name = plane.name or free_name(spec, f"plane/{number}")


def free_name(spec: Any, name: str) -> str:
    """Return ``name``, or a longer one if a geom or height field of ``spec`` has it."""
    while spec.geom(name) is not None or spec.hfield(name) is not None:
        name += "_"
    return name


def bound_planes(spec: Any, model: Any) -> bool:
    """Replace the contacts of finite planes that are no floor by invisible boxes behind them.

    Args:
        spec: The scene, with its floor at z = 0; changed in place.
        model: The compiled scene.

    Returns:
        Whether a plane was changed.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    below = level_planes(model, data) & (np.array(data.geom_xpos)[:, 2] <= HEIGHT_TOLERANCE)
    solid = np.array(model.geom_contype | model.geom_conaffinity) > 0
    finite = np.array(model.geom_size)[:, :2].min(axis=1) > 0
    planes = np.flatnonzero((np.array(model.geom_type) == _PLANE) & ~below & solid & finite)
    for k in planes:
        plane = spec.geom(model.geom(k).name)
        plane.contype = plane.conaffinity = 0
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[k])
        box = spec.worldbody.add_geom(
            name=free_name(spec, f"{plane.name}/solid"),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=data.geom_xpos[k] - HALF_THICKNESS * data.geom_xmat[k].reshape(3, 3)[:, 2],
            quat=turn,
            size=[*model.geom_size[k, :2], HALF_THICKNESS],
            rgba=[0, 0, 0, 0],  # rays pass fully transparent geoms
        )
        reset_contact(box)
        box.group = HIDDEN_GROUP
    return bool(len(planes))


def level_planes(model: Any, data: Any) -> BoolArray:
    """Return which geoms of ``model`` (ngeom,) are planes that face up."""
    up = np.array(data.geom_xmat)[:, 8] >= MIN_LEVEL_COSINE
    result: BoolArray = (np.array(model.geom_type) == _PLANE) & up
    return result


def find_floor_planes(model: Any) -> tuple[str, ...]:
    """Return the names of the level planes at z = 0 of a compiled scene."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    even = np.abs(np.array(data.geom_xpos)[:, 2]) <= HEIGHT_TOLERANCE
    return tuple(model.geom(k).name for k in np.flatnonzero(level_planes(model, data) & even))


def lay_floor(
    spec: Any,
    compiled: tuple[Any, Any],
    starts: Sequence[FloatArray],
    targets: set[str],
    fallback: float,
) -> bool:
    """Find the floor of ``spec``, or add one, and move it to z = 0.

    Args:
        spec: The scene; changed in place.
        compiled: A copy of it that is compiled, and the model.
        starts: Places of the robot's start, or possible ones, (n, 3) [m]; the median floor counts.
            Later ones count where there is no floor below the earlier, but below most of them.
        targets: Names of the target's geoms, which are no floor.
        fallback: Height of the floor that is added where there is none [m].

    Returns:
        Whether ``spec`` was changed.
    """
    # Find the floor
    copy, model = compiled
    floors = _find_floors_below(model, starts, targets)
    height, geom = floors[(len(floors) - 1) // 2] if floors else (fallback, -1)

    # Let it carry the robot
    if geom < 0:
        _add_floor(spec, height)
        changed = True
    else:
        changed = _carry(spec, copy, model, geom)

    # Move it to z = 0
    if abs(height) > HEIGHT_TOLERANCE:
        _lower(spec, height)
        changed = True
    return changed


def compile_scene(spec: Any, label: str) -> Any:
    """Return the compiled model of ``spec``.

    Raises:
        SceneError: It does not compile.
    """
    try:
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise SceneError(f"{label} does not compile: {reason}") from None


def _find_floors_below(
    model: Any, starts: Sequence[FloatArray], targets: set[str]
) -> list[tuple[float, int]]:
    """Return heights [m] and geoms of the floors below the first of ``starts`` that has some."""
    for number, places in enumerate(starts):
        found = _find_floors(model, places, targets)
        if found and (number == 0 or len(found) > len(places) / 2):
            return sorted(found)
    return []


def _find_floors(model: Any, starts: FloatArray, targets: set[str]) -> list[tuple[float, int]]:
    """Return height [m] and geom of the floor under each of ``starts`` that has one."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    planes = [
        (float(data.geom_xpos[k, 2]), int(k)) for k in np.flatnonzero(level_planes(model, data))
    ]
    found = []
    for start in starts:
        # Drop a plumb line; continue planes beyond their pictures
        top = float(start[2]) + ROBOT_HEIGHT
        floors = [each for each in planes if top - MAX_FLOOR_DEPTH <= each[0] <= top]
        floors += _drop_plumb_line(model, data, np.array([start[0], start[1], top]), targets)

        # Take the highest
        if floors:
            found.append(max(floors))
    return found


def _drop_plumb_line(
    model: Any, data: Any, origin: FloatArray, targets: set[str]
) -> list[tuple[float, int]]:
    """Return height [m] and geom of the first flat, level surface below ``origin`` (3,), if any.

    What is not flat or not level, and the target, is no floor; the line passes it.
    """
    geom, normal, z = np.full(1, -1, np.int32), np.zeros(3), float(origin[2])
    for _ in range(MAX_PASSED):
        place = np.array([origin[0], origin[1], z])
        depth = mujoco.mj_ray(model, data, place, _DOWN, None, 1, -1, geom, normal)
        if not 0 <= depth <= MAX_FLOOR_DEPTH - (origin[2] - z):
            break
        k, z = int(geom[0]), z - depth
        flat = mujoco.mjtGeom(int(model.geom_type[k])) in _FLAT and normal[2] >= MIN_LEVEL_COSINE
        if flat and model.geom(k).name not in targets:
            return [(z, k)]
        z -= HEIGHT_TOLERANCE
    return []


def _add_floor(spec: Any, height: float) -> None:
    """Add an endless floor at ``height`` [m]."""
    floor = spec.worldbody.add_geom(
        name=free_name(spec, "floor"),
        type=_PLANE,
        pos=[0, 0, height],
        size=[0, 0, 0.1],
        rgba=_GREY,
    )
    reset_contact(floor)


def _carry(spec: Any, compiled: Any, model: Any, geom: int) -> bool:
    """Make a geom of ``spec`` solid and visible; return whether it was not.

    Args:
        spec: The scene; changed in place.
        compiled: A copy of it that is compiled.
        model: The compiled model.
        geom: Number of the geom in the model.
    """
    for own, twin in zip(spec.geoms, compiled.geoms, strict=True):
        if twin.id == geom:
            hollow = not (own.contype or own.conaffinity)
            unseen = not is_visible(model, geom)
            make_solid(own)
            if unseen:
                own.material, own.rgba = "", _GREY
            return hollow or unseen
    return False


def _lower(spec: Any, height: float) -> None:
    """Move all of ``spec`` down by ``height`` [m]."""
    world = spec.worldbody
    shift = world.add_frame(name="scan3d.floor")
    shift.pos = [0, 0, -height]
    parts = (world.bodies, world.geoms, world.sites, world.cameras, world.lights)
    for part in [each for kind in parts for each in kind]:
        if part.frame is None:
            part.set_frame(shift)
    for frame in world.frames:
        if frame.frame is None and frame.name != shift.name:
            frame.set_frame(shift)


def widen_floors(spec: Any, model: Any, places: FloatArray) -> bool:
    """Make floors at z = 0 endless whose picture ends where the robot drives.

    Args:
        spec: The scene; changed in place.
        model: The compiled scene.
        places: Corners of the target and the robot's start (n, 3) [m].

    Returns:
        Whether a floor was changed.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    changed = False
    for k in np.flatnonzero(level_planes(model, data)):
        # Compare reach and extent
        local = (places - data.geom_xpos[k]) @ data.geom_xmat[k].reshape(3, 3)
        needed = np.abs(local[:, :2]).max(axis=0) + DRIVING_RANGE
        size = np.array(model.geom_size[k, :2])
        if abs(data.geom_xpos[k, 2]) > HEIGHT_TOLERANCE or not np.any((size > 0) & (size < needed)):
            continue

        # Make it endless
        plane = spec.geom(model.geom(k).name)
        plane.size = [0, 0, max(float(plane.size[2]), 0.01)]
        changed = True
    return changed
