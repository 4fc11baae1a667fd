"""The physics: a scene with the robot, stepped at 2 ms, with a history of their poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.scanning.calibration.extrinsics import yaw_matrix
from scan3d_twin.core.scanning.patterns import find_mount
from scan3d_twin.core.types import FloatArray, IntArray, read_only
from scan3d_twin.devices.registry import base_device
from scan3d_twin.sim.base.uneven_floor import draw_uneven_floor, lay_floor
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.resources import find_resource_dir
from scan3d_twin.sim.scenes.mjcf.floors import find_floor_planes
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.turntable.body import add_turntable

PREFIX = "robot/"
TIMESTEP = 0.002
"""Physics step [s]; 1 to 4 ms agree within .5 %, 2 ms keeps the tilt under .5 deg."""
SETTLE_TIME = 1.0
"""Physics time before time 0, for the suspension to settle [s]."""
HISTORY_STEPS = 16_384
"""Number of latest steps whose poses are kept: 32 s, a sweep of 300 lines."""
YAW_BASE = "yaw-base"
"""The pattern without a turntable."""
_SIDES = (("left", 1), ("right", -1))
TRACE_SENSORS = slice(-6, None)
"""Sensors with a history: the lidar's position and axes; the base's position and quaternion."""


@dataclass(frozen=True)
class RobotErrors:
    """The errors of one robot, drawn once.

    Attributes:
        wheel_radius: Relative error of the left and right wheel's radius (2,).
        wheel_base: Relative error of the wheel base.
        friction: Sliding friction of the tyres, where the scene states none.
        cogging: Amplitude of the cogging torque [N m].
        cogging_phase: Phase of the left and right wheel's cogging (2,) [rad].
        floor: Heights of an uneven floor on a square grid (n, n) [m]; None for an even floor.
        mount: Extrinsic error of the lidar: to the left [m], roll, pitch and yaw [rad] (4,).
    """

    wheel_radius: FloatArray
    wheel_base: float
    friction: float
    cogging: float
    cogging_phase: FloatArray
    floor: FloatArray | None = None
    mount: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @staticmethod
    def draw(config: RobotErrorConfig, rng: np.random.Generator) -> RobotErrors:
        """Return the errors of a random robot."""
        return RobotErrors(
            wheel_radius=read_only(config.wheel_radius * rng.standard_normal(2)),
            wheel_base=config.wheel_base * float(rng.standard_normal()),
            friction=float(rng.uniform(config.friction_min, config.friction_max)),
            cogging=config.cogging,
            cogging_phase=read_only(rng.uniform(0.0, 2 * np.pi, 2)),
            floor=draw_uneven_floor(config, rng) if config.uneven > 0 else None,
            mount=(
                config.mount_lateral,
                config.mount_roll,
                config.mount_pitch,
                config.mount_yaw,
            ),
        )

    def on(self, scene: Scene) -> RobotErrors:
        """Return the errors with the friction of ``scene``, if it states one."""
        return self if scene.friction is None else replace(self, friction=scene.friction)


def robot_spec(robot: str, pattern: str = YAW_BASE, *, hinged: bool = False) -> Any:
    """Return the robot's own ``MjSpec``, with the body and the wheels of its data sheet.

    Args:
        robot: Name of the base.
        pattern: What turns the lidar; a turntable is on its mast unless the base does.
        hinged: Whether the turntable is on a hinge of the model, see ``add_turntable``.
    """
    device = base_device(robot)
    own = "stand.xml" if device.spec.is_stand else "create2.xml"
    path = device.mjcf or find_resource_dir("assets") / "mjcf" / own
    spec = mujoco.MjSpec.from_file(str(path))
    if device.mjcf is None:
        chassis = spec.geom("chassis")
        chassis.size = [device.spec.radius, *chassis.size[1:]]
    radius, half = device.spec.wheel_diameter / 2, device.spec.wheel_base / 2
    for side, sign in () if device.spec.is_stand else _SIDES:
        tyre = spec.geom(f"{side}_tyre")
        tyre.size = [radius, tyre.size[1], radius]
        spec.body(f"{side}_mount").pos = [0, sign * half, radius]
    if (mount := find_mount(pattern)) is not None:
        add_turntable(spec, mount, hinged=hinged)
    for sensor in spec.sensors[TRACE_SENSORS]:
        sensor.nsample = HISTORY_STEPS
    return spec


@dataclass(frozen=True, slots=True)
class Solver:
    """Settings of the physics solver.

    Attributes:
        timestep: Step [s]; 1 to 4 ms agree within .5 %, 2 ms keeps the tilt under .5 deg.
        impratio: Ratio of frictional to normal impedance; with 1 a turn of 90 deg is .1 deg worse
            than with 10.
    """

    timestep: float = TIMESTEP
    impratio: float = 10.0


def build_model(
    scene: Scene,
    robot: str,
    errors: RobotErrors,
    solver: Solver | None = None,
    pattern: str = YAW_BASE,
    turn: FloatArray | None = None,
) -> Any:
    """Return the compiled model of ``scene`` with a robot of these ``errors`` at its spawn.

    A turntable for a ``pattern`` is on its mast; without one, the lidar is turned by ``turn``
    (3, 3) on its mount.

    Raises:
        SceneError: They do not compile together, as with a keyframe without the robot's joints.
    """
    # Put the robot at the spawn
    spec = scene.spec.copy()
    half = scene.spawn.yaw / 2
    frame = spec.worldbody.add_frame(
        pos=[scene.spawn.x, scene.spawn.y, 0.0], quat=[np.cos(half), 0, 0, np.sin(half)]
    )
    child = robot_spec(robot, pattern)

    # Apply its errors
    errors = errors.on(scene)
    if not base_device(robot).spec.is_stand:
        _apply_wheel_errors(child, errors)
    if pattern == YAW_BASE and any(errors.mount):
        _tilt_lidar(child.site("lidar"), errors.mount)
    if pattern == YAW_BASE and turn is not None:
        _turn_lidar(child.site("lidar"), turn)
    spec.attach(child, prefix=PREFIX, frame=frame)
    if errors.floor is not None:
        lay_floor(spec, errors.floor, find_floor_planes(scene.model))

    # Set the solver
    _set_options(spec.option, Solver() if solver is None else solver)
    if scene.model.nv == 0:  # the robot is the only island; finding islands costs 7 % of a step
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND

    # Compile the model
    try:
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise SceneError(f"scene {scene.name} cannot take a robot: {reason}") from None


def _apply_wheel_errors(spec: Any, errors: RobotErrors) -> None:
    for side, index in (("left", 0), ("right", 1)):
        tyre = spec.geom(f"{side}_tyre")
        size, friction = np.array(tyre.size), np.array(tyre.friction)
        size[[0, 2]] *= 1 + errors.wheel_radius[index]
        friction[0] = errors.friction
        tyre.size, tyre.friction = size, friction
        mount = spec.body(f"{side}_mount")
        mount.pos = np.array(mount.pos) * (1, 1 + errors.wheel_base, 1)
        motor = spec.actuator(f"{side}_cogging")
        motor.biasprm[0], motor.biasprm[2] = errors.cogging, errors.cogging_phase[index]


def _tilt_lidar(site: Any, mount: tuple[float, float, float, float]) -> None:
    """Move the lidar's ``site`` to the left [m], and turn it by roll, pitch and yaw [rad]."""
    lateral, roll, pitch, yaw = mount
    site.pos[1] += lateral
    half = np.array([roll, pitch]) / 2
    (cr, cp), (sr, sp) = np.cos(half), np.sin(half)
    site.quat = [cp * cr, cp * sr, sp * cr, -sp * sr]  # about y after about x
    if yaw != 0.0:
        _turn_lidar(site, yaw_matrix(yaw))


def _turn_lidar(site: Any, turn: FloatArray) -> None:
    """Turn the lidar's ``site`` by ``turn`` (3, 3), before its errors."""
    quaternion, turned = np.empty(4), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).ravel())
    mujoco.mju_mulQuat(turned, quaternion, site.quat)
    site.quat = turned


def _set_options(option: Any, solver: Solver) -> None:
    """Set the solver options that the robot was tuned with, over the scene's own."""
    option.timestep = solver.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = solver.impratio
    option.iterations = max(int(option.iterations), 20)  # 3 give wrong results without a warning
    option.gravity = [0, 0, -9.81]


@dataclass(frozen=True, slots=True)
class Carriage:
    """What a turntable carries.

    Attributes:
        angles: Return its true angles (n,) [rad] at times (n,) [s].
        T_axis_lidar: Where the lidar is on it (4, 4).
        lean: Rotation of the true axis against the nominal one (3, 3); None where they agree.
    """

    angles: Callable[[FloatArray], FloatArray]
    T_axis_lidar: FloatArray
    lean: FloatArray | None = None

    def carry(
        self, positions: FloatArray, rotations: FloatArray, times: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the lidar's positions (n, 3) and rotations (n, 3, 3) from those of the axis."""
        angles, turn = self.angles(times), np.zeros_like(rotations)
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
        turn[:, 1, 0] = np.sin(angles)
        turn[:, 0, 1] = -turn[:, 1, 0]
        turn[:, 2, 2] = 1.0
        leaning = rotations if self.lean is None else rotations @ self.lean
        turned = leaning @ turn
        T = self.T_axis_lidar
        return positions + turned @ T[:3, 3], turned @ T[:3, :3]


class World:
    """A running physics simulation.

    Time is ``steps * timestep`` since the robot has settled. The poses of a step are known one
    step later: after ``mj_step`` MuJoCo's derived fields still describe the state before it.
    """

    def __init__(self, scene: Scene, model: Any) -> None:
        # Set up model and data
        self.model = model
        self.data = mujoco.MjData(model)
        self.steps = 0
        self.timestep = float(model.opt.timestep)
        self._settled = round(SETTLE_TIME / self.timestep)

        # Let the suspension settle
        self._scene_nq = scene.model.nq  # attached last, the robot comes after the scene's joints
        mujoco.mj_step(model, self.data, nstep=self._settled)
        mujoco.mj_forward(model, self.data)

        # Take views of MuJoCo's arrays
        free = model.joint(PREFIX + "free").qposadr[0]
        self._base_qpos = self.data.qpos[free : free + 7]
        histories = [
            _history(model, self.data, sensor, self._settled)
            for sensor in range(model.nsensor)[TRACE_SENSORS]
        ]
        self._lidar, self._base = histories[:4], histories[4:]
        self.carriage: Carriage | None = None

    @property
    def time(self) -> float:
        """Time since the robot was opened [s]."""
        return self.steps * self.timestep

    def scene_qpos(self) -> FloatArray:
        """Return a copy of the positions of the scene's moving objects; empty when static."""
        return np.array(self.data.qpos[: self._scene_nq])

    def advance(self, steps: int) -> None:
        """Run ``steps`` physics steps; MuJoCo records the poses."""
        mujoco.mj_step(self.model, self.data, nstep=steps)
        self.steps += steps

    def base_rows(self, steps: IntArray) -> FloatArray:
        """Return the base's position and quaternion (n, 7) at recent ``steps`` (n,).

        The present step is included.
        """
        rows = _columns(self._base, self._slots(steps))
        rows[steps == self.steps] = self._base_qpos
        return rows

    def lidar_poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lidar's positions (n, 3) [m] and rotations (n, 3, 3) in ``map``."""
        first = max(0, self.steps - HISTORY_STEPS)
        rows = interpolate(self._lidar_rows, times / self.timestep, first, self.steps)
        positions, rotations = rows[:, :3], rows[:, 3:].reshape(-1, 3, 3).transpose(0, 2, 1)
        if self.carriage is None:
            return positions, rotations
        return self.carriage.carry(positions, rotations, times)

    def _lidar_rows(self, steps: IntArray) -> FloatArray:
        """Return the lidar's position and axes (n, 12) at recent ``steps`` (n,)."""
        return _columns(self._lidar, self._slots(steps))

    def _slots(self, steps: IntArray) -> IntArray:
        """Return the slots of ``steps`` since time 0 in the ring of the history."""
        return (steps + self._settled) % HISTORY_STEPS


def _history(model: Any, data: Any, sensor: int, settled: int) -> FloatArray:
    """Return MuJoCo's history of ``sensor`` as a view (HISTORY_STEPS, dim).

    The history is a ring whose slot 0 belongs to the very first step; ``mjData.history`` holds two
    numbers of its state, then the times, then the values.
    """
    dim = int(model.sensor_dim[sensor])
    times = int(model.sensor_historyadr[sensor]) + 2
    values = times + HISTORY_STEPS
    latest = settled - 1
    if not np.isclose(data.history[times + latest], data.time - model.opt.timestep):
        raise SceneError(f"MuJoCo {mujoco.__version__} keeps its history of sensors otherwise")
    result: FloatArray = data.history[values : values + HISTORY_STEPS * dim].reshape(
        HISTORY_STEPS, dim
    )
    return result


def _columns(histories: list[FloatArray], rows: IntArray) -> FloatArray:
    """Return ``rows`` (n,) of several histories side by side (n, k)."""
    return np.concatenate([history.take(rows, axis=0) for history in histories], axis=1)


def interpolate(
    rows: Callable[[IntArray], FloatArray], times: FloatArray, first: int, end: int
) -> FloatArray:
    """Return values (n, k) at ``times`` (n,) [steps], linear between those of ``rows`` at steps.

    Steps ``first`` to ``end`` - 1 are known; 2 ms apart, the error of a linear rotation is less
    than 1e-7.
    """
    place = np.minimum(np.maximum(times, first), end - 1)
    lower = np.minimum(place.astype(np.int64), max(first, end - 2))
    start = int(lower.min())
    steps = np.arange(start, int(lower.max()) + 2)
    window = rows(np.minimum(steps, end - 1))
    rises = window[1:] - window[:-1]
    share = (place - lower)[:, None]
    lower -= start
    result: FloatArray = rises.take(lower, axis=0)
    result *= share
    result += window.take(lower, axis=0)
    return result
