"""Random scenes: a target of random shape and material, in a room or in the open.

All draws lie in the ranges of ``SceneRanges``; the same generator state gives the same scene. The
target stands in the middle of ``map``, the robot starts at a distance and roughly faces it, and its
path round the target is free. ``load_scene("random:7")`` returns the scene of seed 7 of the default
ranges.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.config import MotionConfig, Tour
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.scenes.random_ranges import SceneRanges, Shape
from scan3d_twin.sim.scenes.random_shapes import Solid, build_shape, draw_uniform
from scan3d_twin.sim.scenes.scene import Scene, scene_from_spec
from scan3d_twin.sim.scenes.walls import add_walls

NAME_PREFIX = "random:"
"""Prefix of the seed in a scene's name."""
_STREAM = 7
"""Separates the draws of scene k from those of a run with seed k."""
TURNING_ROOM = 0.20
"""Free room besides the standoff and the robot's diameter [m]; assumption."""
MIN_START_DISTANCE = 1.5
"""Least distance of clutter from the robot's start, so that the target is most salient [m]."""
MIN_WALL_DISTANCE = 0.8
"""Least distance of a target for tour front to the wall behind it [m]; nearer, stray points would
join the two in a panorama."""


def draw_scene(
    rng: np.random.Generator, ranges: SceneRanges | None = None, name: str = "random"
) -> Scene:
    """Return a random scene drawn from ``ranges``; None for the default ones."""
    ranges = SceneRanges() if ranges is None else ranges

    # Draw shape, heading and standoff
    shape = ranges.shapes[int(rng.integers(len(ranges.shapes)))]
    tour = ranges.tours[int(rng.integers(len(ranges.tours)))]
    turn = draw_uniform(rng, ranges.turn if tour == "front" else (-math.pi, math.pi))
    solids = [solid.moved(Pose2(0.0, 0.0, turn)) for solid in build_shape(shape, rng, ranges)]
    standoff, start = draw_uniform(rng, ranges.standoff), draw_uniform(rng, ranges.start)

    # Add the target
    spec = mujoco.MjSpec()
    spec.modelname = name
    _add_target(spec, solids, rng, ranges)

    # Place the robot's start
    corners = np.concatenate([solid.corners() for solid in solids])
    R = float(np.linalg.norm(corners, axis=1).max())
    spawn = Pose2(-R - start, 0.0, draw_uniform(rng, ranges.heading))
    way = R + max(standoff, start) + 2 * MotionConfig().robot_radius + TURNING_ROOM

    # Add room and clutter
    limits = _add_room(spec, R, way, tour, rng, ranges)
    _add_clutter(spec, spawn, way, limits, rng, ranges)
    _add_site(spec, "spawn", spawn)

    # Add front and conventions
    if tour == "front":
        outward = Pose2(0.0, 0.0, turn).rotate(np.array([-1.0, 0.0]))
        place = float((corners @ outward).max()) * outward
        heading = math.atan2(outward[1], outward[0])
        _add_site(spec, "front", Pose2(float(place[0]), float(place[1]), heading))
    _add_customs(spec, shape, tour, standoff, draw_uniform(rng, ranges.friction))
    return scene_from_spec(name, spec, name)


def scene_of_seed(name: str) -> Scene:
    """Return the scene called ``random:SEED``.

    Raises:
        ConfigError: SEED is no whole number >= 0.
    """
    text = name.removeprefix(NAME_PREFIX)
    if not (text.isascii() and text.isdigit()):
        raise ConfigError(f"a random scene is random:SEED, SEED a whole number >= 0, got {name!r}")
    rng = np.random.default_rng([int(text), _STREAM])
    return draw_scene(rng, name=f"random_{int(text)}")


def _add_target(
    spec: Any, solids: list[Solid], rng: np.random.Generator, ranges: SceneRanges
) -> None:
    """Add the target's solids, of one common material or one each."""
    alike = bool(rng.integers(2))
    common = _add_material(spec, "target", rng, ranges)

    # Add one geom per solid
    for k, solid in enumerate(solids):
        material = common if alike else _add_material(spec, f"target_{k}", rng, ranges)
        name = f"target_{k}"
        place = (solid.place.x, solid.place.y, solid.bottom + solid.size[2])
        geom = spec.worldbody.add_geom(
            name=name, pos=place, quat=_quaternion(solid.place.yaw), material=material
        )
        if solid.kind == "box":
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, solid.size
        elif solid.kind == "cylinder":
            geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER
            geom.size = (solid.size[0], solid.size[2], 0.0)
        elif solid.mesh is not None:
            vertices, faces = solid.mesh
            spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel())
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, name


def _add_material(spec: Any, name: str, rng: np.random.Generator, ranges: SceneRanges) -> str:
    """Add a random material and return its name."""
    kind, material = float(rng.random()), spec.add_material(name=name)
    grey, roughness = draw_uniform(rng, ranges.albedo), draw_uniform(rng, ranges.gloss)
    dark, chrome = draw_uniform(rng, ranges.dark_albedo), draw_uniform(rng, ranges.chrome)
    if ranges.matte <= kind < ranges.matte + ranges.dark:
        grey = dark
    elif ranges.matte + ranges.dark <= kind < ranges.matte + ranges.dark + ranges.glossy:
        material.metallic, material.roughness = 0.0, roughness
    elif kind >= ranges.matte + ranges.dark + ranges.glossy:
        material.metallic, material.roughness, grey = 1.0, chrome, 0.9
    material.rgba = (grey, grey, grey, 1.0)
    return name


def _add_room(
    spec: Any,
    R: float,
    way: float,
    tour: Tour,
    rng: np.random.Generator,
    ranges: SceneRanges,
) -> FloatArray:
    """Add a floor and perhaps walls; return the limits of the room (-x, +x, -y, +y) [m]."""
    # Add light and floor
    spec.worldbody.add_light(pos=(0, 0, 3), dir=(0.3, 0, -1))
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(8, 8, 0.1), rgba=(0.55, 0.55, 0.55, 1)
    )

    # Draw the limits of the room
    limits = way + rng.uniform(*ranges.spare, 4)
    behind = R + MIN_WALL_DISTANCE + draw_uniform(rng, ranges.spare)
    if tour == "front":
        limits[1] = behind  # tour front needs no path behind the target
    if rng.random() >= ranges.walls:
        return limits

    add_walls(spec, limits)
    return limits


def _add_clutter(
    spec: Any,
    spawn: Pose2,
    way: float,
    limits: FloatArray,
    rng: np.random.Generator,
    ranges: SceneRanges,
) -> None:
    """Add clutter to the room, outside the robot's path and away from its start."""
    wanted = int(rng.integers(ranges.clutter[0], ranges.clutter[1] + 1))
    placed: list[tuple[float, float, float]] = []

    # Draw places until enough are free
    for _ in range(10 * wanted):
        radius = draw_uniform(rng, ranges.clutter_radius)
        x = float(rng.uniform(-limits[0], limits[1]))
        y = float(rng.uniform(-limits[2], limits[3]))
        inside = (
            -limits[0] + radius < x < limits[1] - radius
            and -limits[2] + radius < y < limits[3] - radius
        )
        apart = all(math.dist((x, y), (u, v)) > radius + r for u, v, r in placed)
        off = spawn.distance(Pose2(x, y)) > MIN_START_DISTANCE + radius
        if inside and apart and off and math.hypot(x, y) > way + radius and len(placed) < wanted:
            _add_thing(spec, f"thing_{len(placed)}", (x, y, radius), rng, ranges)
            placed.append((x, y, radius))


def _add_thing(
    spec: Any,
    name: str,
    where: tuple[float, float, float],
    rng: np.random.Generator,
    ranges: SceneRanges,
) -> None:
    """Add a box, a cylinder or a ball of radius ``where[2]`` [m]."""
    x, y, radius = where
    half = draw_uniform(rng, (0.05, 0.30))
    kind = int(rng.integers(3))
    geom = spec.worldbody.add_geom(name=name, material=_add_material(spec, name, rng, ranges))
    geom.pos = (x, y, radius if kind == 2 else half)
    if kind == 0:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, (0.7 * radius, 0.7 * radius, half)
        geom.quat = _quaternion(draw_uniform(rng, (-math.pi, math.pi)))
    elif kind == 1:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CYLINDER, (radius, half, 0.0)
    else:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, (radius, 0.0, 0.0)


def _add_site(spec: Any, name: str, pose: Pose2) -> None:
    spec.worldbody.add_site(name=name, pos=(pose.x, pose.y, 0), quat=_quaternion(pose.yaw), group=4)


def _add_customs(spec: Any, shape: Shape, tour: Tour, standoff: float, friction: float) -> None:
    """Add the ``<custom>`` elements of the scene conventions."""
    where = "front only" if tour == "front" else "all round"
    spec.add_text(name="scan3d.tour", data=tour)
    spec.add_text(name="scan3d.description", data=f"random: {shape.replace('_', ' ')}, {where}")
    spec.add_numeric(name="scan3d.standoff", data=[standoff], size=1)
    spec.add_numeric(name="scan3d.friction", data=[friction], size=1)


def _quaternion(yaw: float) -> tuple[float, float, float, float]:
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
