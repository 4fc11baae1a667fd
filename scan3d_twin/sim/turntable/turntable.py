"""The simulated turntable behind the hardware interface."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import TurntableSpec
from scan3d_twin.core.types import FloatArray, TableAngle
from scan3d_twin.sim.turntable.model import CABLE_LIMIT, TurntableModel
from scan3d_twin.sim.turntable.motion import Motion
from scan3d_twin.sim.world import HISTORY_STEPS, World

MIN_HISTORY = 20_000
"""Number of latest samples that are always kept: several minutes."""


class SimTurntable:
    """A ``Turntable`` on the twin; a ``Device`` of its clock."""

    def __init__(
        self, world: World, model: TurntableModel, rng: np.random.Generator, worn: float = 1.0
    ) -> None:
        """Rest at the angle 0.

        Args:
            world: Its time.
            model: What it is.
            rng: Draws its play, and the noise of its sensor.
            worn: Factor of its play.
        """
        self._world, self._model, self._rng = world, model, rng
        self.spec = TurntableSpec(
            name=model.name,
            min_angle=-CABLE_LIMIT,
            max_angle=CABLE_LIMIT,
            max_speed=model.max_speed,
            resolution=model.resolution,
            sample_period=model.sample_period,
            play=model.play,
        )
        drawn = max(0.0, 1 + model.play_spread * float(rng.standard_normal()))
        self.play = worn * model.play * drawn
        self._motion = Motion(self.play, HISTORY_STEPS * world.timestep)
        self._samples = 0
        self.next_step = self._due(1)
        self._history = [self._sample(0.0)]

    def turn_to(self, angle: float, speed: float) -> tuple[float, float]:
        """See ``Turntable.turn_to``.

        Raises:
            ConfigError: The angle is not finite, or the speed not positive.
        """
        if not (math.isfinite(angle) and math.isfinite(speed) and speed > 0):
            raise ConfigError(f"a turntable turns to an angle at a speed > 0, got {angle}, {speed}")
        model, spec = self._model, self.spec
        goal = _round(min(max(angle, spec.min_angle), spec.max_angle), model.resolution)
        sent = max(1, round(min(speed, spec.max_speed) / model.speed_step)) * model.speed_step
        sent = min(sent, spec.max_speed)
        self._motion.turn(self._world.time, goal, sent, model.acceleration)
        return goal, sent

    def stop(self) -> None:
        """See ``Turntable.stop``."""
        self._motion.stop(self._world.time, self._model.acceleration)

    def angle(self) -> TableAngle:
        """See ``Turntable.angle``."""
        return self._history[-1]

    def angles_since(self, stamp: float) -> tuple[TableAngle, ...]:
        """See ``Turntable.angles_since``."""
        after = bisect_right(self._history, stamp, key=lambda sample: sample.stamp)
        return tuple(self._history[max(0, after - 1) :])

    def carried_at(self, times: FloatArray) -> FloatArray:
        """Return the true angle of the lidar at ``times`` (n,) [s] of the last half minute."""
        return self._motion.carried_at(times)

    def service(self) -> None:
        """Take a sample of the angle sensor."""
        self._samples += 1
        self.next_step = self._due(self._samples + 1)
        self._history.append(self._sample(self._world.time))
        if len(self._history) >= 2 * MIN_HISTORY:
            del self._history[:MIN_HISTORY]

    def _due(self, sample: int) -> int:
        """Return the physics step of sample number ``sample``."""
        return math.ceil(sample * self._model.sample_period / self._world.timestep - 1e-9)

    def _sample(self, time: float) -> TableAngle:
        """Return what its sensor says at ``time`` [s]."""
        model, angle = self._model, self._motion.servo_at(time)[0]
        noisy = angle + model.noise * float(self._rng.standard_normal())
        return TableAngle(_round_down(time + model.clock_offset, model.clock_step),
                          _round(noisy, model.resolution))  # fmt: skip


def _round(value: float, step: float) -> float:
    """Return ``value`` as a whole number of steps."""
    return round(value / step) * step


def _round_down(value: float, step: float) -> float:
    """Return ``value`` as a whole number of steps, rounded down; as it is for no step."""
    return math.floor(value / step + 1e-9) * step if step > 0 else value
