"""The simulated base: drive commands, odometry and safety sensors with every packet."""

from __future__ import annotations

import math
from bisect import bisect_right

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.navigation.wheel_kinematics import ACCELERATION, wheel_speeds
from scan3d_twin.core.types import Hazards, Odometry
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.sim.base.odometers import Sample, make_odometer
from scan3d_twin.sim.base.safety_sensors import Feelers
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.world import PREFIX, World

HISTORY = 20_000
"""Odometry samples that are kept at least: 5 minutes."""
SURPLUS = 2_000
"""So many older ones are forgotten at a time."""


class SimBase:
    """A ``DriveBase`` on the twin.

    Sensor packets are taken in every sample period; they become odometry when somebody asks for it.
    """

    def __init__(
        self, world: World, device: BaseDevice, errors: RobotErrorConfig | None = None
    ) -> None:
        errors = RobotErrorConfig() if errors is None else errors
        self.spec = spec = device.spec
        self._world = world
        model, data = world.model, world.data
        names = [f"{PREFIX}{side}" for side in ("left", "right")]
        self._drives = [int(model.actuator(name + "_drive").id) for name in names]
        self._wheels = [int(model.joint(name + "_wheel").qposadr[0]) for name in names]
        self._qpos, self._radius = data.qpos, spec.wheel_diameter / 2
        self._ramp = ACCELERATION * spec.sample_period / self._radius
        self._feelers = Feelers(world, spec.sample_period, errors.battery_life)
        self._target = (0.0, 0.0)
        self._driven = (0.0, 0.0)
        self._samples = 0
        self.next_step = self._due(1)
        self._zero = [float(data.qpos[wheel]) for wheel in self._wheels]
        self._odometer = make_odometer(device, errors)
        self._pending: list[Sample] = []
        self._history = [self._odometer.update(Sample(0.0, (0.0, 0.0), (0.0, 0.0)))]
        self._hazards = Hazards()

    def _due(self, sample: int) -> int:
        """Return the physics step of sensor packet number ``sample``."""
        return math.ceil(sample * self.spec.sample_period / self._world.timestep - 1e-9)

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``."""
        left, right = self._target = wheel_speeds(self.spec, linear, angular)
        return (left + right) / 2, (right - left) / self.spec.wheel_base

    def stop(self) -> None:
        """Stop the wheels at once, without the ramp."""
        self._target = self._driven = (0.0, 0.0)
        self._world.data.ctrl[self._drives] = 0.0

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        self._reckon()
        return self._history[-1]

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        self._reckon()
        after = bisect_right(self._history, stamp, key=lambda sample: sample.stamp)
        return tuple(self._history[max(0, after - 1) :])

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._hazards

    def wall(self) -> bool:
        """Return whether the wall sensor sees a wall on the right."""
        return self._feelers.wall()

    def service(self) -> None:
        """Take in a sensor packet and move the wheel speeds towards the command.

        Raises:
            HazardError: A new hazard, or the robot drives on into an old one; the wheels stand.
        """
        self._samples += 1
        self.next_step = self._due(self._samples + 1)
        time, qpos, radius = self._world.time, self._qpos, self._radius
        left = qpos.item(self._wheels[0]) - self._zero[0]
        right = qpos.item(self._wheels[1]) - self._zero[1]
        sent = (self._driven[0] * radius, self._driven[1] * radius)
        self._pending.append(Sample(time, (left, right), sent))
        if len(self._pending) >= SURPLUS:
            self._reckon()
        before, self._hazards = self._hazards, self._feelers.hazards(self._driven)
        names = _blocking(before, self._hazards, self._target)
        if names:
            self.stop()
            raise HazardError(f"stopped: {', '.join(names)} at {time:.2f} s")
        self._accelerate()

    def _reckon(self) -> None:
        """Make odometry of the packets that came in since."""
        update = self._odometer.update
        self._history += [update(sample) for sample in self._pending]
        self._pending.clear()
        del self._history[: max(0, len(self._history) - HISTORY) // SURPLUS * SURPLUS]

    def _accelerate(self) -> None:
        step, wanted = self._ramp, (self._target[0] / self._radius, self._target[1] / self._radius)
        if wanted == self._driven:
            return
        left, right = (
            now + min(max(end - now, -step), step)
            for now, end in zip(self._driven, wanted, strict=True)
        )
        self._driven = (left, right)
        ctrl = self._world.data.ctrl
        ctrl[self._drives[0]], ctrl[self._drives[1]] = left, right


def _blocking(before: Hazards, now: Hazards, target: tuple[float, float]) -> tuple[str, ...]:
    """Return the hazards to stop for: new ones, and old ones if the robot drives on ahead."""
    if now.battery <= 0:
        return (*now.active(), "battery empty")
    if now == before and sum(target) <= 0:
        return ()
    active = now.active()
    if sum(target) > 0 or not active:
        return active
    known = before.active()
    return tuple(name for name in active if name not in known)
