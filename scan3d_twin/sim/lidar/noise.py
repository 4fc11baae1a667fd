"""Errors of a reading: random noise, and biases that averaging does not remove.

Arrays have the shape (lines, beams). Random draws are arguments, so that a line is the same alone
and in a sweep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.types import FloatArray
from scan3d_twin.devices.device import LidarSensor
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.footprint import wave_numbers

FAR_DISTANCE, FAR_WIDTH = 2.0, 0.2
"""Distance at which the range noise steps up, and width of the step [m]; see ``sigma_far``."""
REPEAT_WITHIN = 2.0
"""Largest difference of a repeated reading, in standard deviations of the noise; assumption."""


@dataclass(frozen=True, slots=True)
class Draws:
    """The random draws of m lines.

    Attributes:
        seen: Standard normal draws for the detection (m, n).
        noise: Standard normal draws, correlated between neighbours (m, n).
        chance: Uniform draws in 0..1 for repeats and glitches (m, n).
        pointing: Standard normal draws for the beams' directions (m, n); None where these are
            exact.
    """

    seen: npt.NDArray[np.floating[Any]]
    noise: FloatArray
    chance: FloatArray
    pointing: npt.NDArray[np.floating[Any]] | None = None

    @staticmethod
    def of(rngs: list[np.random.Generator], beams: int, config: LidarModelConfig) -> Draws:
        """Draw for the lines of ``rngs``, one each."""
        seen = np.empty((len(rngs), beams), np.float32)  # precise enough for a comparison
        noise = np.empty((len(rngs), beams + 1))
        chance = np.empty((len(rngs), beams))
        for k, rng in enumerate(rngs):
            rng.standard_normal(out=seen[k], dtype=np.float32)
            rng.standard_normal(out=noise[k])
            rng.random(out=chance[k])
        noise = _correlate(noise, config)
        if config.pointing == 0:
            return Draws(seen, noise, chance)
        pointing = np.empty((len(rngs), beams), np.float32)
        for k, rng in enumerate(rngs):
            rng.standard_normal(out=pointing[k], dtype=np.float32)
        return Draws(seen, noise, chance, pointing)

    def select(self, beams: slice) -> Draws:
        """Return the draws of some ``beams`` of each line."""
        pointing = None if self.pointing is None else self.pointing[:, beams]
        return Draws(self.seen[:, beams], self.noise[:, beams], self.chance[:, beams], pointing)


def _correlate(white: FloatArray, config: LidarModelConfig) -> FloatArray:
    """Return ``white`` (m, n + 1) as (m, n) with correlation ``neighbours`` between neighbours."""
    rho = config.neighbours
    if rho == 0:
        return white[:, 1:]
    # x_i + b x_(i - 1) has the correlation b / (1 + b^2).
    b = 2 * rho / (1 + math.sqrt(1 - 4 * rho**2))
    mixed: FloatArray = white[:, 1:] + b * white[:, :-1]
    mixed /= math.sqrt(1 + b**2)
    return mixed


def range_sigma(
    distances: FloatArray, power: FloatArray, cosines: FloatArray, config: LidarModelConfig
) -> FloatArray:
    """Return the standard deviation of readings [m], shaped as ``distances`` [m]."""
    far = np.minimum(np.maximum((distances - FAR_DISTANCE) / FAR_WIDTH, 0.0), 1.0)
    sigma = config.sigma + config.sigma_per_metre * distances + config.sigma_far * far
    sigma *= 1 + config.sigma_incidence - config.sigma_incidence * (cosines * cosines)
    weak = config.sigma_weak**2 * config.threshold
    result: FloatArray = np.sqrt(sigma * sigma + weak / np.maximum(power, config.threshold + 1e-12))
    return result


def cyclic_bias(distances: FloatArray, config: LidarModelConfig, sensor: LidarSensor) -> FloatArray:
    """Return the phase measurement's error [m]; two cycles per turn of the phase."""
    if sensor.modulations is None:
        return np.zeros_like(distances)
    result: FloatArray = config.bias * np.sin(2 * wave_numbers(sensor.modulations)[0] * distances)
    return result


def warm_up_error(time: float, config: LidarModelConfig) -> float:
    """Return the warm-up error [m] of a sensor switched on ``time`` [s] ago."""
    return config.warm_up * math.exp(-time / config.warm_up_time)


def repeat_readings(
    readings: FloatArray, sigma: FloatArray, chance: FloatArray, config: LidarModelConfig
) -> FloatArray:
    """Return ``readings`` (m, n) [m], some replaced by the one before, as the firmware does."""
    if config.repeats == 0:
        return readings
    repeats = chance < config.repeats
    repeats[:, 0] = False
    repeats[:, 1:] &= np.abs(readings[:, 1:] - readings[:, :-1]) < REPEAT_WITHIN * sigma[:, 1:]
    source = np.arange(readings.size).reshape(readings.shape)
    source[repeats] = 0
    np.maximum.accumulate(source, axis=1, out=source)
    result: FloatArray = readings.take(source)
    return result
