"""The simulated base: drive commands, odometry and safety sensors with every packet."""

from __future__ import annotations

import math
from bisect import bisect_right

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.navigation.wheel_kinematics import (
    WHEEL_ACCELERATION,
    split_velocity,
)
from scan3d_twin.core.types import Hazards, Odometry
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.sim.base.odometers import Sample, make_odometer
from scan3d_twin.sim.base.safety_sensors import SafetySensors
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.world import PREFIX, World

MIN_HISTORY = 20_000
"""Number of latest odometry samples that are always kept: 5 minutes."""
FORGET_BATCH = 2_000
"""Number of older samples that are discarded at once."""


class SimBase:
    """A ``DriveBase`` on the twin.

    A sensor packet is sampled every 15 ms; odometry is computed from the packets on demand.
    """

    def __init__(
        self, world: World, device: BaseDevice, errors: RobotErrorConfig | None = None
    ) -> None:
        # Find its parts in the model
        errors = RobotErrorConfig() if errors is None else errors
        self.spec = spec = device.spec
        self._world = world
        model, data = world.model, world.data
        names = [f"{PREFIX}{side}" for side in ("left", "right")]
        self._drives = [int(model.actuator(name + "_drive").id) for name in names]
        self._wheels = [int(model.joint(name + "_wheel").qposadr[0]) for name in names]
        self._qpos, self._radius = data.qpos, spec.wheel_diameter / 2
        self._ramp = WHEEL_ACCELERATION * spec.sample_period / self._radius

        # Start sensors and commands at rest
        self._feelers = SafetySensors(world, spec.sample_period, errors.battery_life)
        self._target = (0.0, 0.0)
        self._driven = (0.0, 0.0)

        # Start the odometry
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
        left, right = self._target = split_velocity(self.spec, linear, angular)
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

    def sense(self) -> Hazards:
        """Return what the safety sensors report at rest, between packets too."""
        return self._feelers.hazards((0.0, 0.0))

    def wall(self) -> bool:
        """Return whether the wall sensor sees a wall on the right."""
        return self._feelers.wall()

    def service(self) -> None:
        """Sample a sensor packet and ramp the wheel speeds towards the command.

        Raises:
            HazardError: A hazard is new, or the robot drives on into an old one; the wheels are
                stopped.
        """
        # Sample a sensor packet
        self._samples += 1
        self.next_step = self._due(self._samples + 1)
        time, qpos, radius = self._world.time, self._qpos, self._radius
        left = qpos.item(self._wheels[0]) - self._zero[0]
        right = qpos.item(self._wheels[1]) - self._zero[1]
        sent = (self._driven[0] * radius, self._driven[1] * radius)
        self._pending.append(Sample(time, (left, right), sent))
        if len(self._pending) >= FORGET_BATCH:
            self._reckon()

        # Stop the wheels for hazards
        before, self._hazards = self._hazards, self._feelers.hazards(self._driven)
        names = _blocking(before, self._hazards, self._target)
        if names:
            self.stop()
            raise HazardError(f"stopped: {', '.join(names)} at {time:.2f} s")

        # Ramp towards the command
        self._accelerate()

    def _reckon(self) -> None:
        """Compute odometry from the pending packets."""
        update = self._odometer.update
        self._history += [update(sample) for sample in self._pending]
        self._pending.clear()
        del self._history[: max(0, len(self._history) - MIN_HISTORY) // FORGET_BATCH * FORGET_BATCH]

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
    """Return the hazards to stop for: new ones, and old ones if the robot drives forward."""
    active = now.active()
    if now.battery <= 0:
        return (*active, "battery empty")
    if not active:
        return ()
    if now == before and sum(target) <= 0:
        return ()
    if sum(target) > 0:
        return active
    known = before.active()
    return tuple(name for name in active if name not in known)
