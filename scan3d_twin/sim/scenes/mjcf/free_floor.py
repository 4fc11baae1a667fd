"""Where the robot can start in a scene that states no start: free floor in sight of the target.

A grid of cells around the target is probed with rays: a cell is free if a plumb line through it
meets nothing but floor below the robot's height, and a way between two cells if a level ray between
them meets nothing. The robot fits where all cells within its radius are free; poles between the
rays, and the hulls with which meshes collide, are met by its footprint (``footprint.py``). Of the
places where it fits, those count that show enough of the target (``target_sight.py``).
"""

from __future__ import annotations

import copy
import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2
from scan3d_twin.sim.ray_casting import Hits, RayCaster, choose_caster
from scan3d_twin.sim.scenes.mjcf.floors import ROBOT_HEIGHT, level_planes
from scan3d_twin.sim.scenes.mjcf.footprint import MAX_STEP, RADIUS, Footprint
from scan3d_twin.sim.scenes.mjcf.target_sight import TargetSight
from scan3d_twin.sim.scenes.surface_samples import bounding_points

CELL = 0.1
"""Side of a cell [m]."""
MAX_DISTANCE = 3.0
"""Distance around the target within which a start is looked for [m]."""
WANTED_DISTANCE = 1.5
"""Wanted distance from the start to the target [m]; as in the built-in scenes."""
MIN_ANGLE = np.radians(6.0)
"""Least angle at which the start sees a small target [rad]: three lines of a panorama, which are
2 deg apart."""
MIN_DISTANCE = 0.8
"""Least distance from the start to the target [m]; nearer, panoramas cut it off."""
MAX_SAMPLED = 100
"""About how many places are looked from to learn how much of the target can be seen at once."""
MIN_SHARE_OF_BEST = 0.95
"""Part of the best sight that a start has to offer; assumption."""
MIN_SHARE = 1e-6
"""Least share of the target that a start has to show: any."""
SIDE_WEIGHT = 0.1
"""Cost of starting opposite of the -x side of the target, in metres of distance; it only decides
between places that are about as good."""


_CLOSED = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
)
"""Geom types with an inside, whose normals point out of it."""


def choose_spawn(
    model: Any, spec: Any, targets: tuple[str, ...], points: FloatArray, name: str
) -> Pose2:
    """Return a start on free floor at z = 0 that shows much of the target.

    Args:
        model: The compiled scene.
        spec: The scene, of which a copy is compiled.
        targets: Names of the target's geoms.
        points: Corners of the target (n, 3) [m].
        name: Name of the scene in messages.

    Raises:
        SceneError: There is no free floor in sight of the target.
    """
    # Find where the robot fits at a suitable distance
    caster = choose_caster(_opaque(model))
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    cells, areas = _find_room(model, caster, low, high)
    gap = np.linalg.norm(np.maximum(0, np.maximum(low - cells, cells - high)), axis=-1)
    near = (areas > 0) & (gap >= MIN_DISTANCE) & (gap <= MAX_DISTANCE)
    cells, areas, gap = cells[near], areas[near], gap[near]

    # Sort them by distance and direction
    middle = (low + high) / 2
    wanted = np.clip(float((high - low).min()) / MIN_ANGLE, MIN_DISTANCE, WANTED_DISTANCE)
    cost = np.abs(gap - wanted) + SIDE_WEIGHT * _turn_from_behind(cells - middle)
    order = np.argsort(cost, kind="stable")
    cells, areas = cells[order], areas[order]

    # Take the first that shows enough of the target and where the robot stands free
    sight, footprint = TargetSight(model, targets), Footprint(spec, caster, np.array(model.qpos0))
    area, least = _choose_area(sight, cells, areas)
    hidden = True
    for chosen, share in ((areas == area, least), (areas > 0, MIN_SHARE)):
        for place in cells[chosen]:
            if sight.shares(place[None])[0] < share:
                continue
            hidden = False
            if footprint.is_free(place):
                ahead = middle - place
                return Pose2(float(place[0]), float(place[1]), math.atan2(ahead[1], ahead[0]))

    # Name the cause
    reason = "has room for the robot"
    if hidden and len(cells):
        reason += f" and sees it: {sight.find_cover(cells[0])}"
    raise SceneError(
        f"{name}: no free floor within {MAX_DISTANCE:g} m of the target {reason}; add a site "
        "'spawn' where the robot starts"
    )


def _find_room(
    model: Any, caster: RayCaster, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return cells (n, m, 2) [m] around the box from ``low`` to ``high`` (2,), and their areas.

    Areas (n, m) are numbered from 1; between two of them there is no way for the robot, and 0 is
    where it does not fit.
    """
    from scipy.ndimage import distance_transform_edt, label  # slow to import

    x, y = (np.arange(low[k] - MAX_DISTANCE, high[k] + MAX_DISTANCE + CELL, CELL) for k in range(2))
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    free = _probe(model, caster, cells)
    room = distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * CELL > RADIUS + CELL / 2
    areas, _ = label(room)
    return cells, np.asarray(areas, dtype=np.int64)


def _choose_area(sight: TargetSight, cells: FloatArray, areas: IntArray) -> tuple[int, float]:
    """Return the area to start in, and the share of the target that a start there has to show.

    The area is the one with the most places that show enough: a room that is open above is seen
    into, a little, from the larger floor around it. Area 0, of which there are no ``cells``, if the
    sampled places show nothing.
    """
    at = np.arange(0, len(cells), max(1, len(cells) // MAX_SAMPLED))
    shares = sight.shares(cells[at])
    if not shares.any():
        return 0, MIN_SHARE
    least = MIN_SHARE_OF_BEST * float(shares.max())
    return int(np.argmax(np.bincount(areas[at][shares >= least]))), least


def _opaque(model: Any) -> Any:
    """Return ``model`` with all geoms opaque: rays pass transparent ones, the robot does not."""
    result = copy.copy(model)
    result.geom_matid[:], result.geom_rgba[:, 3] = -1, 1.0
    return result


def _turn_from_behind(offsets: FloatArray) -> FloatArray:
    """Return angles between ``offsets`` (n, 2) and -x, as a share of half a turn (n,)."""
    shares: FloatArray = np.abs(np.arctan2(offsets[:, 1], -offsets[:, 0])) / math.pi
    return shares


def _probe(model: Any, caster: RayCaster, cells: FloatArray) -> BoolArray:
    """Return which of ``cells`` (n, m, 2) are free floor at z = 0 (n, m)."""
    # Drop plumb lines
    flat = cells.reshape(-1, 2)
    down = _cast(model, caster, flat, ROBOT_HEIGHT, (0.0, 0.0, -1.0)).distances
    free = (np.abs(down - ROBOT_HEIGHT) < MAX_STEP) & _in_front_of_planes(model, flat)

    # Look up from the floor, and find what is solid there
    at = np.flatnonzero(free)
    up = _cast(model, caster, flat[at], 2 * MAX_STEP, (0.0, 0.0, 1.0))
    inside = np.isin(model.geom_type[up.geoms], _CLOSED) & (up.normals[:, 2] > 0)
    free[at] = (up.distances > ROBOT_HEIGHT) & ~inside

    # Look to the next cells
    at = np.flatnonzero(free)
    for height in (0.05, 0.15, LIDAR_HEIGHT):
        for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            free[at] &= _cast(model, caster, flat[at], height, (x, y, 0.0)).distances > CELL
    result: BoolArray = free.reshape(cells.shape[:2])
    return result


def _in_front_of_planes(model: Any, places: FloatArray) -> BoolArray:
    """Return which ``places`` (n, 2) [m] lie in front of all solid planes that are no floor (n,).

    What lies behind a plane is solid in MuJoCo.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    front = np.ones(len(places), dtype=bool)
    solid = np.array(model.geom_contype | model.geom_conaffinity) > 0
    plane = np.array(model.geom_type) == mujoco.mjtGeom.mjGEOM_PLANE
    for k in np.flatnonzero(solid & plane & ~level_planes(model, data)):
        normal, point = data.geom_xmat[k].reshape(3, 3)[:, 2], data.geom_xpos[k]
        front &= (places - point[:2]) @ normal[:2] - point[2] * normal[2] > RADIUS
    return front


def _cast(
    model: Any,
    caster: RayCaster,
    places: FloatArray,
    height: float,
    direction: tuple[float, float, float],
) -> Hits:
    """Return the hits of rays from ``places`` (n, 2) at ``height`` [m] along ``direction``."""
    origins = np.column_stack([places, np.full(len(places), height)])
    rays = np.tile(np.array(direction), (len(places), 1))
    return caster.cast(np.array(model.qpos0), origins, rays)


def corners(model: Any, names: tuple[str, ...]) -> FloatArray:
    """Return the corners (n, 3) [m] of the boxes around the geoms ``names``, in ``map``."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parts = []
    for name in names:
        geom = data.geom(name)
        parts.append(bounding_points(model, geom.id) @ geom.xmat.reshape(3, 3).T + geom.xpos)
    return np.concatenate(parts)


def rings(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return places (16, 3) [m] around a target with these corners, at its foot and at its top.

    The foot of one that is sunk into the floor is below the floor.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    radius = float(np.linalg.norm((high - low)[:2])) / 2 + WANTED_DISTANCE
    angles = math.tau * np.arange(16) / 16
    middle = (low + high) / 2
    around = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(16)], axis=1)
    foot, top = np.array([*middle[:2], low[2]]), np.array([*middle[:2], high[2]])
    return foot + around, top + around
