"""A kinematic robot without physics: it follows its odometry, with the errors of its wheels.

The lidar is that of the twin (``scanner.py``) with fewer beams and lines. The robot's errors are
those that the physics would draw; ``motion_errors.py``, fitted to the physics by
``benchmarks/motion_error.py``, gives its true motion. Not simulated: inertia, slip and vibration
within a sweep; bumps and cliffs; skipped beams. A sweep takes milliseconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import default_mount
from scan3d_twin.core.scanning.sweep import find_ends
from scan3d_twin.core.types import (
    FloatArray,
    IntArray,
    LidarSpec,
    Observation,
    Pose2,
    RangeImage,
    read_only,
    wrap,
    wrap_all,
)
from scan3d_twin.devices.registry import base_device, lidar_device
from scan3d_twin.sim.base.motion_errors import (
    SLIP_XY,
    SLIP_YAW,
    apply_motion_errors,
    turn_scale,
)
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.scanner import Scanner
from scan3d_twin.sim.ray_casting import RayCaster
from scan3d_twin.sim.robot import Stream, draw_robot, stream
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.truth import Truth

TURN_PER_MOVE = math.pi
"""Sum of the turns between two viewpoints [rad]: a quarter turn off the target and one back."""


@dataclass(frozen=True, slots=True)
class Thinning:
    """The part of the lidar's steps and lines that is simulated.

    Attributes:
        beams: Stride of the steps; 3 is 1.06 deg, which sees an unbroken floor up to 2.7 m away.
        lines: Stride of the lines of a sweep; with a stride of 2 upright edges are less exact and
            twice as many views are misplaced (docs/gym.md).
        looks: Stride of the lines of a panorama; 2 is 4 deg at 20 deg/s.
        lowest: Elevation of the lowest beam [rad]; lower ones see only the floor under the robot.
        highest: Elevation of the highest beam [rad]; the target's window ends at 37.5 deg.
    """

    beams: int = 3
    lines: int = 1
    looks: int = 1
    lowest: float = math.radians(-62.0)
    highest: float = math.radians(45.0)


def thin_spec(spec: LidarSpec, thinning: Thinning) -> LidarSpec:
    """Return the geometry of a line of ``spec`` after ``thinning``."""
    steps = np.arange(spec.n_beams)[:: thinning.beams]
    elevations = spec.elevations[steps]
    kept = steps[(elevations >= thinning.lowest) & (elevations <= thinning.highest)]
    return replace(
        spec,
        elevations=read_only(spec.elevations[kept]),
        beam_times=read_only(spec.beam_times[kept]),
    )


def thin_config(config: Config, thinning: Thinning) -> Config:
    """Return ``config`` with point counts reduced to those of fewer beams and lines.

    Turns stay uncorrected: the ends of a thinned panorama do not determine the scale of the yaws.
    """
    share = thinning.beams * thinning.lines
    target = replace(config.target, min_points=max(4, config.target.min_points // share))
    sweep = replace(config.sweep, turning="odometry")
    return replace(config, target=target, sweep=sweep)


class KinematicWorld:
    """The true poses of the base over time: knots with linear interpolation."""

    def __init__(self, start: Pose2, qpos: FloatArray | None = None) -> None:
        """Start at ``start``, ``T_map_base``.

        Args:
            start: The base's pose at time 0.
            qpos: Positions of the scene's loose objects, which stay where they are; None for none.
        """
        self._knots = [(0.0, start.x, start.y, start.yaw)]
        self._qpos = np.empty(0) if qpos is None else np.array(qpos)

    @property
    def latest(self) -> float:
        """Time of the latest pose [s]."""
        return self.time

    @property
    def time(self) -> float:
        """Time since the robot was opened [s]."""
        return self._knots[-1][0]

    @property
    def pose(self) -> Pose2:
        """The present ``T_map_base``."""
        return Pose2(*self._knots[-1][1:])

    def add(self, seconds: float, pose: Pose2, turn: float | None = None) -> None:
        """Let ``seconds`` pass, after which the base is at ``pose``.

        Args:
            seconds: Duration [s].
            pose: ``T_map_base`` at the end.
            turn: Angle turned meanwhile [rad]; None for the smallest.
        """
        time, _, _, yaw = self._knots[-1]
        by = wrap(pose.yaw - yaw) if turn is None else turn
        self._knots.append((time + seconds, pose.x, pose.y, yaw + by))

    def base_poses(self, times: FloatArray) -> FloatArray:
        """Return x, y [m] and yaw [rad] (n, 3) of ``T_map_base`` at ``times`` (n,) [s].

        They are clamped to the first and last knot.
        """
        knots = np.array(self._knots)
        after = np.searchsorted(knots[:, 0], times, side="right")
        start = knots.take(np.maximum(after - 1, 0), axis=0)
        rises = knots.take(np.minimum(after, len(knots) - 1), axis=0) - start
        seconds = rises[:, :1]
        rates = np.divide(rises, seconds, out=np.zeros_like(rises), where=seconds > 0)
        poses: FloatArray = (rates * (times[:, None] - start[:, :1]) + start)[:, 1:]
        poses[:, 2] = wrap_all(poses[:, 2])
        return poses

    def scene_qpos(self) -> FloatArray:
        """Return the positions of the scene's loose objects; empty when static."""
        return self._qpos


class KinematicRobot:
    """A robot without physics that takes panoramas and sweeps in a static scene."""

    def __init__(
        self,
        scene: Scene,
        caster: RayCaster,
        seed: int,
        twin: TwinConfig,
        config: Config,
        thinning: Thinning,
    ) -> None:
        """Open the robot that ``seed`` draws from ``twin``, as ``open_sim`` would."""
        if twin.pattern != "yaw-base":
            raise ConfigError(f"no turntable, as for the pattern {twin.pattern}, without physics")

        # Skipped beams leave the others without neighbours
        lidar = replace(twin.lidar.for_single_beams(), line_loss=0.0)
        device = lidar_device(twin.lidar_model)
        spec = thin_spec(device.spec(twin.lidar_link), thinning)
        surfaces = stream(seed, Stream.SURFACE)
        self._scanner = Scanner(
            scene.model, twin.robot, spec, lidar, caster, surfaces, device.sensor
        )
        self._rng, self._config, self._thinning = stream(seed, Stream.LIDAR), config, thinning

        # Draw the robot, open the truth
        self._errors = draw_robot(scene, seed, twin.errors)
        self._spec = base_device(twin.robot).spec
        self.world = KinematicWorld(scene.spawn, scene.model.qpos0)
        self.here = Pose2()
        self.truth = Truth(scene, self.world, caster, lambda: None)
        self.path = 0.0

    def take_panorama(self) -> Observation:
        """Return a panorama, a coarse sweep all round, from where the robot stands."""
        sweep = self._config.sweep
        ends = math.pi, math.pi
        return self._sweep(self.here.yaw, ends, sweep.look_rate, self._thinning.looks)

    def observe(
        self, path: FloatArray, yaw: float, half: float | None = None, beyond: float = 0.0
    ) -> Observation:
        """Drive along ``path`` (n, 2) in ``odom`` [m] and sweep about the heading ``yaw`` there.

        ``half`` and ``beyond`` [rad] are those of ``sweep``.
        """
        motion, sweep = self._config.motion, self._config.sweep
        near = self._rng.uniform(-0.5, 0.5, 2) * motion.position_tolerance
        places = path.copy()
        places[-1:] += near
        self._move(places, yaw)
        ends = find_ends(sweep.width / 2 + sweep.margin, half, beyond)
        return self._sweep(yaw, ends, sweep.yaw_rate, self._thinning.lines)

    def _move(self, path: FloatArray, yaw: float) -> None:
        """Follow ``path`` (n, 2) in ``odom`` [m] and turn to ``yaw`` [rad]."""
        true = apply_motion_errors(self.here, path, yaw, self._spec, self._errors)
        slip = Pose2(*((SLIP_XY, SLIP_XY, SLIP_YAW) * self._rng.standard_normal(3)))
        motion = self._config.motion
        places = np.concatenate([[[self.here.x, self.here.y]], path])
        length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        seconds = length / motion.speed + TURN_PER_MOVE / motion.turn_rate
        self.world.add(seconds, self.world.pose @ true @ slip)
        x, y = places[-1].tolist()
        self.here = Pose2(x, y, yaw)

    def _sweep(self, yaw: float, ends: tuple[float, float], rate: float, every: int) -> Observation:
        """Turn right between ``ends`` to the left and right of ``yaw``, reading lines."""
        # Compute the headings of all beams
        spec, scale = self._scanner.spec, turn_scale(self._errors)
        period = spec.line_period * every
        left, right = ends
        first = left - rate * period * float(self._rng.random())
        count = math.floor((first + right) / (rate * period)) + 1
        yaws = first - rate * (period * np.arange(count)[:, None] + spec.beam_times)

        # Turn and measure
        started = self._turn_through(ends, rate) + (left - first) / rate
        true = self.world.pose
        ranges, codes = self._measure(true, scale * yaws)

        # Assemble the range image
        image = RangeImage(
            stamps=read_only(started + period * np.arange(count)),
            yaws=read_only(yaws),
            ranges=read_only(ranges),
            codes=read_only(codes, np.int64),
            spec=spec,
            T_base_lidar=default_mount(),
        )
        return Observation(image, Pose2(self.here.x, self.here.y, yaw))

    def _turn_through(self, ends: tuple[float, float], rate: float) -> float:
        """Let the time of a sweep pass and return its start [s]; the robot ends at its heading."""
        world, motion, scale = self.world, self._config.motion, turn_scale(self._errors)
        here, (left, right) = world.pose, ends
        first = Pose2(here.x, here.y, here.yaw + left * scale)
        world.add(left / motion.turn_rate + self._config.sweep.settle, first, left * scale)
        started = world.time
        last = Pose2(here.x, here.y, here.yaw - right * scale)
        world.add((left + right) / rate, last, -(left + right) * scale)
        world.add(right / motion.turn_rate, here, right * scale)
        return started

    def _measure(self, true: Pose2, yaws: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return ranges [m] and codes (m, n) of beams at ``yaws`` (m, n) about the true pose."""
        # Place the lidar at each beam
        m, n = yaws.shape
        angles = true.yaw + yaws
        c, s = np.cos(angles), np.sin(angles)
        ahead, up = default_mount()[0, 3], default_mount()[2, 3]
        positions = np.empty((m, n, 3))
        positions[..., 0], positions[..., 1] = true.x + ahead * c, true.y + ahead * s
        positions[..., 2] = up

        # Draw the noise and measure
        draws = Draws(
            self._rng.standard_normal((m, n), dtype=np.float32),
            self._rng.standard_normal((m, n)),
            self._rng.random((m, n)),
        )
        still = np.zeros(m)
        readings = self._scanner.measure_upright(
            self.world.scene_qpos(), positions, (c, s), draws, still
        )
        return readings.ranges, readings.codes
