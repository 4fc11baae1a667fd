"""The simulated iRobot Create 2: encoders, drive commands and safety sensors every 15 ms."""

from __future__ import annotations

import math
from bisect import bisect_right

import mujoco
import numpy as np

from scan3d_twin.core.errors import ConfigError, HazardError
from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.odometry import DeadReckoning
from scan3d_twin.core.types import FloatArray, Hazards, Odometry
from scan3d_twin.sim.world import PREFIX, TIMESTEP, World

CREATE2 = BaseSpec(
    name="create2",
    radius=0.165,  # create_robot URDF
    wheel_base=0.235,  # libcreate types.cpp, as the next two
    wheel_diameter=0.072,
    counts_per_turn=508.8,
    max_wheel_speed=0.5,  # Create 2 Open Interface: +-500 mm/s
    sample_period=0.015,  # Create 2 Open Interface: sensors are updated every 15 ms
)
ACCELERATION = 1.8
"""Of a wheel's rim [m/s^2]; create_robot URDF."""
SPEED_STEP = 0.001
"""Resolution of a wheel's speed [m/s]; opcode 145 takes whole mm/s."""
BUMP_FORCE = 0.5
"""Force that presses the bumper [N]; assumption."""
BUMPER_TRAVEL = 0.004
"""How far the robot must back off before the springs release the bumper [m]; assumption."""
WHEEL_DROP = -0.010
"""Drop of a wheel that opens its switch [m]; assumption, of 25 mm of travel."""
CLIFF_DISTANCE = 0.05
"""Distance below a cliff sensor that counts as a cliff [m]; assumption, the floor is at 22 mm."""
HISTORY = 20_000
"""Odometry samples that are kept at least: 5 minutes."""

_DOWN, _GEOM = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
_CLIFFS = ("cliff_left", "cliff_front_left", "cliff_front_right", "cliff_right")


def wheel_speeds(spec: BaseSpec, linear: float, angular: float) -> tuple[float, float]:
    """Return the (left, right) wheel speeds [m/s] that are sent for a command.

    Too fast a command is slowed down so that the path's curvature is kept; whole mm/s.
    """
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise ConfigError(f"velocity must be finite, got {linear:g} m/s and {angular:g} rad/s")
    left = linear - angular * spec.wheel_base / 2
    right = linear + angular * spec.wheel_base / 2
    scale = min(1.0, spec.max_wheel_speed / max(abs(left), abs(right), SPEED_STEP))
    return (
        round(left * scale / SPEED_STEP) * SPEED_STEP,
        round(right * scale / SPEED_STEP) * SPEED_STEP,
    )


class SimBase:
    """A ``DriveBase`` on the twin."""

    def __init__(self, world: World, spec: BaseSpec = CREATE2) -> None:
        self.spec = spec
        self._world = world
        model, data = world.model, world.data
        names = [PREFIX + side for side in ("left", "right")]
        self._drives = [model.actuator(name + "_drive").id for name in names]
        self._wheels = [model.joint(name + "_wheel").qposadr[0] for name in names]
        self._drops = [model.joint(name + "_drop").qposadr[0] for name in names]
        self._bumps = [model.sensor(PREFIX + "bump_" + s).adr[0] for s in ("left", "right")]
        self._place = data.body(PREFIX + "base").xpos
        self._pressed_at: list[FloatArray | None] = [None, None]
        self._cliffs = [data.site(PREFIX + name).xpos for name in _CLIFFS]
        self._body = model.body(PREFIX + "base").id
        self._target = (0.0, 0.0)
        self._samples = 0
        self._zero = [float(data.qpos[wheel]) for wheel in self._wheels]
        self._reckoning = DeadReckoning(spec, 0, 0)
        self._history = [self._reckoning.update(0.0, 0, 0)]
        self._hazards = Hazards()

    @property
    def next_step(self) -> int:
        """The physics step of the next sensor packet."""
        return math.ceil((self._samples + 1) * self.spec.sample_period / TIMESTEP - 1e-9)

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``."""
        left, right = self._target = wheel_speeds(self.spec, linear, angular)
        return (left + right) / 2, (right - left) / self.spec.wheel_base

    def stop(self) -> None:
        """Stop the wheels at once, without the ramp."""
        self._target = (0.0, 0.0)
        self._world.data.ctrl[self._drives] = 0.0

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        return self._history[-1]

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        after = bisect_right(self._history, stamp, key=lambda sample: sample.stamp)
        return tuple(self._history[max(0, after - 1) :])

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._hazards

    def service(self) -> None:
        """Take in a sensor packet and move the wheel speeds towards the command.

        Raises:
            HazardError: A new hazard, or the robot drives on into an old one; the wheels stand.
        """
        self._samples += 1
        left, right = (self._counts(side) for side in (0, 1))
        self._history.append(self._reckoning.update(self._world.time, left, right))
        if len(self._history) > 2 * HISTORY:
            del self._history[:HISTORY]
        before, self._hazards = self._hazards, self._sense()
        if names := _blocking(before, self._hazards, self._target):
            self.stop()
            raise HazardError(f"stopped: {', '.join(names)} at {self._world.time:.2f} s")
        self._ramp()

    def _counts(self, side: int) -> int:
        turned = float(self._world.data.qpos[self._wheels[side]]) - self._zero[side]
        # Rounded, not floored: at rest it stands in the middle of a count, not on its edge.
        return round(turned / math.tau * self.spec.counts_per_turn)

    def _ramp(self) -> None:
        ctrl, radius = self._world.data.ctrl, self.spec.wheel_diameter / 2
        step = ACCELERATION * self.spec.sample_period / radius
        for drive, speed in zip(self._drives, self._target, strict=True):
            ctrl[drive] += min(max(speed / radius - ctrl[drive], -step), step)

    def _sense(self) -> Hazards:
        data = self._world.data
        bumps = [self._bumped(side) for side in (0, 1)]
        drops = [bool(data.qpos[adr] < WHEEL_DROP) for adr in self._drops]
        cliffs = [not 0 <= self._distance_below(site) <= CLIFF_DISTANCE for site in self._cliffs]
        return Hazards(*bumps, *cliffs, *drops)

    def _bumped(self, side: int) -> bool:
        if self._world.data.sensordata[self._bumps[side]] > BUMP_FORCE:
            self._pressed_at[side] = np.array(self._place)
        pressed_at = self._pressed_at[side]
        if pressed_at is None:
            return False
        return math.dist(pressed_at[:2], self._place[:2]) < BUMPER_TRAVEL

    def _distance_below(self, point: FloatArray) -> float:
        """Return the distance from ``point`` (3,) down to the scene [m]; -1 where there is none.

        Cast only when a packet is due: as MuJoCo sensors the rays would cost every physics step.
        """
        model, data = self._world.model, self._world.data
        return float(mujoco.mj_ray(model, data, point, _DOWN, None, 1, self._body, _GEOM, None))


def _blocking(before: Hazards, now: Hazards, target: tuple[float, float]) -> tuple[str, ...]:
    """Return the hazards to stop for: new ones, and old ones if the robot drives on ahead."""
    active = now.active()
    fresh = tuple(name for name in active if name not in before.active())
    return active if sum(target) > 0 else fresh
