"""Random scenes: a target of random shape and material, in a room or in the open.

All draws lie in the ranges of ``SceneRanges``; the same generator state gives the same scene. The
target stands in the middle of ``map``, the robot starts at a distance and roughly faces it, and its
path round the target is free. ``load_scene("random:7")`` returns the scene of seed 7 of the default
ranges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.config import MotionConfig, Tour
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.scenes.random_shapes import (
    Shape,
    Solid,
    build_shape,
    draw_uniform,
    shape_names,
)
from scan3d_twin.sim.scenes.scene import Scene, scene_from_spec

NAME_PREFIX = "random:"
"""Prefix of the seed in a scene's name."""
_STREAM = 7
"""Separates the draws of scene k from those of a run with seed k."""
Interval = tuple[float, float]
TURNING_ROOM = 0.20
"""Free room besides the standoff and the robot's diameter [m]; assumption."""
MIN_START_DISTANCE = 1.5
"""Least distance of clutter from the robot's start, so that the target is most salient [m]."""
MIN_WALL_DISTANCE = 0.8
"""Least distance of a target for tour front to the wall behind it [m]; nearer, stray points would
join the two in a panorama."""
WALL_HALF_HEIGHT, WALL_HALF_THICKNESS = 1.25, 0.05
"""Half height and half thickness of walls [m]; as in the built-in scenes."""


@dataclass(frozen=True, slots=True)
class SceneRanges:
    """Ranges of random scenes: uniform intervals (low, high) in SI units.

    Sizes are those of furniture and boxes that a robot 35 cm high can see completely: assumptions.
    """

    shapes: tuple[Shape, ...] = field(default_factory=shape_names)
    """Shapes of the target, equally likely."""
    tours: tuple[Tour, ...] = ("front", "full")
    """Whether it is scanned from the front or all round, equally likely."""
    width: Interval = (0.35, 1.50)
    """Width of the target across the robot's view [m]; a sweep covers 1.15 m at 1 m standoff."""
    depth: Interval = (0.20, 0.60)
    """Depth of each part along the robot's view [m]."""
    height: Interval = (0.30, 0.90)
    """Height of each part [m]; the window of 75 deg ends at 1.07 m at a standoff of 1 m."""
    gap: Interval = (0.04, 0.12)
    """Gap between parts [m]; from 0.20 m on they count as two targets."""
    setback: Interval = (0.0, 0.15)
    """Setback of a part's front behind the foremost one [m]; paper, Fig. 13."""
    radius: Interval = (0.12, 0.35)
    """Radius of cylinders [m]."""
    amplitude: Interval = (0.01, 0.03)
    """Amplitude of a wavy side [m]; paper, Fig. 10: 0.02."""
    period: Interval = (0.08, 0.25)
    """Period of a wavy side [m]; paper, Fig. 10: 0.08."""
    rise: Interval = (0.12, 0.20)
    """Rise of a step [m]; DIN 18065: 0.14 to 0.20."""
    going: Interval = (0.15, 0.30)
    """Going (depth) of a step [m]; DIN 18065: 0.23 to 0.32."""
    turn: Interval = (-0.35, 0.35)
    """Heading of a target for tour front [rad]; others have any heading."""
    start: Interval = (1.0, 1.4)
    """Distance from the target's circumcircle to the robot's start [m]."""
    heading: Interval = (-0.3, 0.3)
    """The robot's heading at its start, relative to the target's middle [rad]."""
    standoff: Interval = (0.9, 1.1)
    """Scanning distance [m]; the built-in scenes have 1.0."""
    walls: float = 0.75
    """Share of the scenes that lie in a room, 0..1."""
    spare: Interval = (0.0, 0.8)
    """Room beyond the robot's path round the target, on each side [m]."""
    clutter: tuple[int, int] = (0, 6)
    """Number of objects of clutter; fewer where they do not fit."""
    clutter_radius: Interval = (0.06, 0.17)
    """Radius of these objects [m]."""
    matte: float = 0.60
    """Share of matte surfaces, 0..1."""
    dark: float = 0.15
    """Share of dark matte surfaces, 0..1."""
    glossy: float = 0.15
    """Share of glossy plastic, 0..1; the rest is chrome."""
    albedo: Interval = (0.40, 0.90)
    """Reflectance of matte and glossy surfaces."""
    dark_albedo: Interval = (0.10, 0.25)
    """Reflectance of dark surfaces; the URG-04LX sees 10 % grey to 4 m."""
    gloss: Interval = (0.20, 0.45)
    """Roughness of glossy plastic."""
    chrome: Interval = (0.30, 0.50)
    """Roughness of chrome: a cylinder loses 15 to 0 % of its readings at 1.2 m."""
    friction: Interval = (0.40, 1.00)
    """Sliding friction between floor and tyres."""

    def __post_init__(self) -> None:
        # Check the intervals
        for name in _LIMITS:
            _check_interval(name, getattr(self, name))

        # Check shapes and tours
        _require(bool(self.shapes) and bool(self.tours), "random.shapes and random.tours: name one")
        for shape in self.shapes:
            if shape not in shape_names():
                raise UnknownNameError("shape", shape, shape_names())
        for tour in self.tours:
            if tour not in ("front", "full"):
                raise UnknownNameError("tour", tour, ("front", "full"))

        # Check the shares
        for name in ("walls", "matte", "dark", "glossy"):
            share = getattr(self, name)
            _require(0.0 <= share <= 1.0, f"random.{name} must be in [0, 1], got {share:g}")
        rest = 1.0 - self.matte - self.dark - self.glossy
        _require(rest > -1e-9, "random.matte + random.dark + random.glossy must be <= 1")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ConfigError(message)


_LIMITS: dict[str, Interval] = {
    "width": (0.1, 3.0), "depth": (0.05, 2.0), "height": (0.1, 2.0), "gap": (0.0, 0.15),
    "setback": (0.0, 0.5), "radius": (0.05, 1.0), "amplitude": (0.0, 0.05), "period": (0.04, 1.0),
    "rise": (0.02, 0.5), "going": (0.05, 1.0), "turn": (-math.pi, math.pi), "start": (0.5, 2.0),
    "heading": (-math.pi, math.pi), "standoff": (0.5, 2.0), "spare": (0.0, 3.0),
    "clutter": (0, 50), "clutter_radius": (0.02, 0.5), "albedo": (0.0, 1.0),
    "dark_albedo": (0.0, 1.0), "gloss": (0.05, 1.0), "chrome": (0.05, 1.0), "friction": (0.1, 2.0),
}  # fmt: skip
"""Limits of the intervals: the range in which robot and lidar work."""


def _check_interval(name: str, value: tuple[float, float]) -> None:
    low, high = _LIMITS[name]
    _require(
        low <= value[0] <= value[1] <= high,
        f"random.{name} must be (low, high) within {low:g} and {high:g}, got {value}",
    )


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

    # Add the four walls
    material = spec.add_material(name="wall", rgba=(0.85, 0.85, 0.82, 1.0)).name
    middle = ((limits[1] - limits[0]) / 2, (limits[3] - limits[2]) / 2)
    half = ((limits[0] + limits[1]) / 2, (limits[2] + limits[3]) / 2)
    for name, x, y, long in (
        (
            "back",
            -limits[0] - WALL_HALF_THICKNESS,
            middle[1],
            (WALL_HALF_THICKNESS, half[1] + 2 * WALL_HALF_THICKNESS),
        ),
        (
            "front",
            limits[1] + WALL_HALF_THICKNESS,
            middle[1],
            (WALL_HALF_THICKNESS, half[1] + 2 * WALL_HALF_THICKNESS),
        ),
        ("right", middle[0], -limits[2] - WALL_HALF_THICKNESS, (half[0], WALL_HALF_THICKNESS)),
        ("left", middle[0], limits[3] + WALL_HALF_THICKNESS, (half[0], WALL_HALF_THICKNESS)),
    ):
        spec.worldbody.add_geom(
            name=f"wall_{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, WALL_HALF_HEIGHT),
            size=(*long, WALL_HALF_HEIGHT),
            material=material,
        )
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
