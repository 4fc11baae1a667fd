"""Opening the twin: a robot behind the hardware interface, and the truth behind its back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import IntEnum
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import Robot, default_mount
from scan3d_twin.core.scanning.calibration.extrinsics import apply_mount, tilt_matrix
from scan3d_twin.core.scanning.patterns import TableMount, find_mount
from scan3d_twin.core.types import FloatArray, LidarSpec
from scan3d_twin.devices.registry import base_device, lidar_device
from scan3d_twin.sim.base.drive_base import SimBase
from scan3d_twin.sim.base.stand import SimStand
from scan3d_twin.sim.clock import SimClock
from scan3d_twin.sim.config import RobotErrorConfig, TwinConfig
from scan3d_twin.sim.lidar.lidar import SimLidar
from scan3d_twin.sim.lidar.rotating import RotatingLidar
from scan3d_twin.sim.lidar.scanner import Scanner
from scan3d_twin.sim.ray_casting import RayCaster, choose_caster, choose_patient_caster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.start_check import check_place, check_stand
from scan3d_twin.sim.trace import PoseTrace
from scan3d_twin.sim.truth import Truth
from scan3d_twin.sim.turntable.model import find_turntable
from scan3d_twin.sim.turntable.turntable import SimTurntable
from scan3d_twin.sim.world import Carriage, RobotErrors, Solver, World, build_model

MANY_MESHES = 8
"""Number of mesh geoms from which exact rays take too long: a robot arm of 58 was evaluated for
more than two minutes."""


class Stream(IntEnum):
    """Sources of randomness under one seed; a new one gets a new number, so that others stay."""

    ROBOT = 0
    LIDAR = 1
    SURFACE = 2
    TURNTABLE = 3


Table = tuple[TableMount, SimTurntable]
"""A turntable and where it is."""
Parts = tuple[World, SimBase | SimStand, SimLidar, SimClock, Table | None]
"""The parts of the twin."""


def stream(seed: int, which: Stream) -> np.random.Generator:
    """Return the random generator of one source under ``seed``."""
    return np.random.default_rng([seed, which])


def draw_robot(scene: Scene, seed: int, config: RobotErrorConfig) -> RobotErrors:
    """Return the robot that ``seed`` draws, on the floor of ``scene``."""
    return RobotErrors.draw(config, stream(seed, Stream.ROBOT)).on(scene)


@contextmanager
def open_sim(
    scene: Scene | str,
    seed: int = 0,
    config: TwinConfig | None = None,
    *,
    solver: Solver | None = None,
    spec: LidarSpec | None = None,
) -> Iterator[tuple[Robot, Truth]]:
    """Open the twin in ``scene``; the wheels are stopped on every way out.

    The robot stands on its suspension when time 0 comes, and its odometry is the identity there.
    The same scene, seed, configuration and calls give bit-identical readings.

    Args:
        scene: A loaded scene, or what ``load_scene`` takes.
        seed: Draws the robot's errors and the sensor's noise.
        config: The twin's parameters; None is the `typical` robot.
        solver: Of the physics; None is the full one.
        spec: Lines of the lidar, measured at these angles; None are those of ``config.lidar_link``.

    Raises:
        ConfigError: There is no such scene, the seed is negative, or ``config`` is no TwinConfig.
        SceneError: The scene cannot be built.

    >>> with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
    ...     robot.clock.sleep(1.0)
    ...     moved = truth.pose_at(1.0).distance(truth.spawn)
    >>> moved < 0.001
    True
    """
    scene = load_scene(scene) if isinstance(scene, str) else scene
    with _open_twin(scene, seed, config, solver, spec) as (
        (world, base, lidar, clock, table), caster,
    ):  # fmt: skip
        trace = PoseTrace(world)
        clock.attach(trace)
        truth = Truth(scene, trace, _reference(scene.model, caster), lidar.evidence)
        yield _assemble(base, lidar, clock, table, config), truth


def _reference(model: Any, caster: RayCaster) -> RayCaster:
    """Return the caster of the truth: exact, or the lidar's where many meshes make that slow."""
    meshes = int(np.count_nonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH))
    still = model.nq == 0 and meshes >= MANY_MESHES
    return caster if still else choose_patient_caster(model)


@contextmanager
def open_robot(scene: Scene | str, seed: int, config: TwinConfig | None = None) -> Iterator[Robot]:
    """Open the twin as ``open_sim`` does, but without its truth, which grows with time.

    Nothing does then, however long the robot runs.

    Raises:
        ConfigError, SceneError: See ``open_sim``.
    """
    scene = load_scene(scene) if isinstance(scene, str) else scene
    with _open_twin(scene, seed, config, None, None) as (parts, _):
        yield _assemble(*parts[1:], config)


def _assemble(
    base: SimBase | SimStand,
    lidar: SimLidar,
    clock: SimClock,
    table: Table | None,
    config: TwinConfig | None,
) -> Robot:
    """Return the robot of these parts; it knows how its lidar is turned on its mount."""
    turn = MountConfig() if config is None else config.turn
    if table is None:
        return Robot(base, lidar, clock, _turn_mount(turn))
    mount, turntable = table
    return Robot(base, lidar, clock, mount.T_base_lidar, turntable, mount.T_base_axis)


@contextmanager
def _open_twin(
    scene: Scene,
    seed: int,
    config: TwinConfig | None,
    solver: Solver | None,
    spec: LidarSpec | None,
) -> Iterator[tuple[Parts, RayCaster]]:
    """Open the parts of the twin; see ``open_sim``."""
    config = TwinConfig() if config is None else config
    if not isinstance(config, TwinConfig):
        raise ConfigError(f"config must be a TwinConfig, got a {type(config).__name__}")
    if seed < 0:
        raise ConfigError(f"seed must be >= 0, got {seed}")
    errors = draw_robot(scene, seed, config.errors)
    turn = None if config.turn == MountConfig() else apply_mount(np.eye(4), config.turn)[:3, :3]
    model = build_model(scene, config.robot, errors, solver, config.pattern, turn)
    start = (scene.spawn.x, scene.spawn.y)
    check_place(model, scene.name, start)
    world = World(scene, model)
    clock = SimClock(world)
    own_base = base_device(config.robot)
    base: SimBase | SimStand
    if own_base.spec.is_stand:
        if find_mount(config.pattern) is None:
            raise ConfigError("a stand does not turn: choose --pattern yaw, pitch or roll")
        base = SimStand(world, own_base.spec)
    else:
        base = SimBase(world, own_base, config.errors)
    table = _open_turntable(world, seed, config)
    check_stand(world, scene.name, start, base.sense())
    caster = choose_caster(scene.model)
    surfaces = stream(seed, Stream.SURFACE)
    device = lidar_device(config.lidar_model)
    fixed_angles = spec is not None
    spec = device.spec(config.lidar_link) if spec is None else spec
    scanner = Scanner(
        scene.model, config.robot, spec, config.lidar, caster, surfaces, device.sensor,
        config.pattern, turn,
    )  # fmt: skip
    own = [seed, Stream.LIDAR]
    if fixed_angles or device.sample_rate is None:
        lidar = SimLidar(world, clock, scanner, own)
    else:
        rate = device.sample_rate(config.lidar_link)
        lidar = RotatingLidar(world, clock, scanner, own, rate)
    clock.attach(lidar, base)
    if table is not None:
        clock.attach(table[1])
    try:
        yield (world, base, lidar, clock, table), caster
    finally:
        base.stop()


def _turn_mount(turn: MountConfig) -> FloatArray:
    """Return ``T_base_lidar`` of a lidar without a turntable, turned on its mount by ``turn``."""
    return default_mount() if turn == MountConfig() else apply_mount(default_mount(), turn)


def _open_turntable(world: World, seed: int, config: TwinConfig) -> Table | None:
    """Return the turntable of ``config`` and its mount, in ``world``; None if the base turns."""
    mount = find_mount(config.pattern)
    if mount is None:
        return None
    errors = config.errors
    model = find_turntable(config.turntable)
    rng = stream(seed, Stream.TURNTABLE)
    turntable = SimTurntable(world, model, rng, errors.table_play)
    mount = replace(mount, T_base_lidar=apply_mount(mount.T_base_lidar, config.turn))
    error = MountConfig(
        errors.mount_lateral, errors.mount_roll, errors.mount_pitch, yaw=errors.mount_yaw
    )
    T_axis_lidar = apply_mount(mount.T_axis_lidar, error)
    lean = _find_lean(mount, errors)
    world.carriage = Carriage(turntable.carried_at, T_axis_lidar, lean)
    return mount, turntable


def _find_lean(mount: TableMount, errors: RobotErrorConfig) -> FloatArray | None:
    """Return the rotation of the true axis against that of ``mount`` (3, 3); None for none."""
    if errors.axis_roll == errors.axis_pitch == 0.0:
        return None
    R = mount.T_base_axis[:3, :3]
    return np.asarray(R.T @ tilt_matrix(errors.axis_roll, errors.axis_pitch) @ R)
