"""Where the robot can start in a scene that states no start: free floor in sight of the target.

A grid of cells around the target is probed with rays: a cell is free if a plumb line through it
meets nothing but floor below the robot's height, and a way between two cells if a level ray between
them meets nothing. The robot fits where all cells within its radius are free.
"""

from __future__ import annotations

import copy
import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import BoolArray, FloatArray, Pose2
from scan3d_twin.sim.ray_casting import RayCaster, choose_caster
from scan3d_twin.sim.scenes.mjcf.floors import ROBOT_HEIGHT, level_planes
from scan3d_twin.sim.scenes.surface_samples import bounding_points

CELL = 0.1
"""Side of a cell [m]; thinner things between two plumb lines are met by level rays."""
REACH = 3.0
"""Distance around the target within which a start is looked for [m]."""
DISTANCE = 1.5
"""Wanted distance from the start to the target [m]; as in the built-in scenes."""
MIN_ANGLE = np.radians(6.0)
"""Least angle at which the start sees a small target [rad]: three lines of a panorama, which are
2 deg apart."""
NEAREST = 0.8
"""Least distance from the start to the target [m]; nearer, panoramas cut it off."""
RADIUS = 0.165 + 0.10
"""Free radius around the start [m]: the robot's and a turn's clearance."""
FLAT = 0.005
"""Height of what the robot drives over [m]; assumption."""
MAX_AIMS = 200
"""About how many points of the target are looked at from a start."""
SIDE_WEIGHT = 0.1
"""Cost of starting opposite of the -x side of the target, in metres of distance; it only decides
between places that are about as good."""


def choose_spawn(model: Any, targets: tuple[str, ...], points: FloatArray, name: str) -> Pose2:
    """Return a start on free floor at z = 0 that sees the target.

    Args:
        model: The compiled scene.
        targets: Names of the target's geoms.
        points: Corners of the target (n, 3) [m].
        name: Name of the scene in messages.

    Raises:
        SceneError: There is no free floor in sight of the target.
    """
    from scipy.ndimage import distance_transform_edt, label  # slow to import

    # Probe the floor around the target
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    x, y = (np.arange(low[k] - REACH, high[k] + REACH + CELL, CELL) for k in range(2))
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    free = _probe(model, choose_caster(_opaque(model)), cells)

    # Keep where the robot fits and has a way round
    room = distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * CELL > RADIUS + CELL / 2
    areas, count = label(room)
    if count:
        room &= areas == 1 + np.argmax(np.bincount(areas.ravel())[1:])

    # Keep where it sees the target
    middle = (low + high) / 2
    gap = np.linalg.norm(np.maximum(0, np.maximum(low - cells, cells - high)), axis=-1)
    room &= (gap >= NEAREST) & (gap <= REACH)
    candidates = cells[room]
    wanted = np.clip(float((high - low).min()) / MIN_ANGLE, NEAREST, DISTANCE)
    cost = np.abs(gap[room] - wanted) + SIDE_WEIGHT * _turn_from_behind(candidates - middle)
    order = np.argsort(cost, kind="stable")
    caster = choose_caster(model)
    ids = [model.geom(target).id for target in targets]
    for place in candidates[order]:
        if _sees(model, caster, place, ids, points):
            ahead = middle - place
            return Pose2(float(place[0]), float(place[1]), math.atan2(ahead[1], ahead[0]))
    raise SceneError(
        f"{name}: no free floor within {REACH:g} m of the target has room for the robot and sees "
        "it; add a site 'spawn' where the robot starts"
    )


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
    # Drop plumb lines, and look up from the floor
    flat = cells.reshape(-1, 2)
    down = _cast(model, caster, flat, ROBOT_HEIGHT, (0.0, 0.0, -1.0))
    free = (np.abs(down - ROBOT_HEIGHT) < FLAT) & _in_front_of_planes(model, flat)
    at = np.flatnonzero(free)
    free[at] = _cast(model, caster, flat[at], 2 * FLAT, (0.0, 0.0, 1.0)) > ROBOT_HEIGHT

    # Look to the next cells
    at = np.flatnonzero(free)
    for height in (0.05, 0.15, LIDAR_HEIGHT):
        for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            free[at] &= _cast(model, caster, flat[at], height, (x, y, 0.0)) > CELL
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
) -> FloatArray:
    """Return distances (n,) [m] from ``places`` (n, 2) at ``height`` [m] along ``direction``."""
    origins = np.column_stack([places, np.full(len(places), height)])
    rays = np.tile(np.array(direction), (len(places), 1))
    if len(places) == 0:
        return np.empty(0)
    return caster.cast(np.array(model.qpos0), origins, rays).distances


def _sees(
    model: Any, caster: RayCaster, place: FloatArray, targets: list[int], points: FloatArray
) -> bool:
    """Return whether the lidar sees the target from ``place`` (2,), towards any of ``points``."""
    origin = np.array([place[0], place[1], LIDAR_HEIGHT])
    stride = max(1, len(points) // MAX_AIMS)
    aims = np.concatenate([points[::stride], points.mean(axis=0, keepdims=True)])
    rays = aims - origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = caster.cast(np.array(model.qpos0), np.tile(origin, (len(rays), 1)), rays)
    return bool(np.isin(hits.geoms, targets).any())


def corners(model: Any, names: tuple[str, ...]) -> FloatArray:
    """Return the corners (n, 3) [m] of the boxes around the geoms ``names``, in ``map``."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parts = []
    for name in names:
        geom = data.geom(name)
        parts.append(bounding_points(model, geom.id) @ geom.xmat.reshape(3, 3).T + geom.xpos)
    return np.concatenate(parts)


def ring(points: FloatArray) -> FloatArray:
    """Return places (16, 3) [m] around a target with these corners, at the height of its foot."""
    low, high = points.min(axis=0), points.max(axis=0)
    radius = float(np.linalg.norm((high - low)[:2])) / 2 + DISTANCE
    angles = math.tau * np.arange(16) / 16
    middle = (low + high) / 2
    around = np.stack([np.cos(angles), np.sin(angles), np.zeros(16)], axis=1)
    places: FloatArray = np.array([middle[0], middle[1], low[2]]) + radius * around
    return places
