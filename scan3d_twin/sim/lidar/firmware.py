"""The sensor's firmware: turns the received light into whole millimetres or an error code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray
from scan3d_twin.devices.device import LidarSensor
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.noise import Draws, cyclic_bias, range_sigma, repeat_readings


@dataclass(frozen=True, slots=True)
class Light:
    """The received light, arrays (m, n_beams).

    Attributes:
        distances: Distance by phase [m]; inf for a miss.
        power: Power of the return; 0 for a miss.
        cosines: Cosine of the incidence in the middle of the beam.
        bias: Range bias of the surface [m].
    """

    distances: FloatArray
    power: FloatArray
    cosines: FloatArray
    bias: FloatArray

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the arrays in the order of the attributes."""
        return self.distances, self.power, self.cosines, self.bias


Broken = tuple[tuple[IntArray, IntArray], IntArray]
"""Rows and columns of the beams that straddle a depth edge, and their codes."""


def read(
    light: Light,
    broken: Broken,
    draws: Draws,
    drift: FloatArray,
    config: LidarModelConfig,
    sensor: LidarSensor,
) -> tuple[FloatArray, IntArray]:
    """Return ranges [m], NaN where there is none, and codes, both (m, n_beams)."""
    power, known = light.power, sensor.codes
    seen = _is_detected(power, draws.seen, config)
    distances = np.where(seen, light.distances, 0.0)
    sigma = range_sigma(distances, power, light.cosines, config)
    readings = cyclic_bias(distances, config, sensor)
    readings += distances + light.bias + drift[:, None] + sigma * draws.noise
    readings = repeat_readings(readings, sigma, draws.chance, config)

    # Round and check the range
    millimetres = np.rint(readings * 1000)
    valid = seen & (millimetres >= sensor.min_range_mm) & (millimetres <= sensor.max_range_mm)
    codes = np.where(valid, VALID, known.no_return)
    if config.threshold > 0:
        codes[~seen & (power > config.threshold / 2)] = known.weak_return
    at, mixed = broken
    if len(mixed):
        codes[at] = np.where(codes[at] == VALID, mixed, codes[at])
    if config.glitch > 0:
        codes[valid & (draws.chance > 1 - config.glitch)] = known.glitch
    if power.max() > config.saturation:
        codes[power > config.saturation] = known.too_strong
    valid = codes == VALID
    codes[_is_isolated(valid)] = known.neighbours_invalid
    return np.where(codes == VALID, millimetres / 1000, np.nan), codes


def _is_detected(
    power: FloatArray, normals: npt.NDArray[np.floating[Any]], config: LidarModelConfig
) -> BoolArray:
    """Return which returns of ``power`` are detected, given standard normal draws."""
    if config.threshold == 0:
        return power > 0
    result: BoolArray = power > config.threshold * np.exp(config.softness * normals)
    return result


def _is_isolated(valid: BoolArray) -> BoolArray:
    """Return where a valid reading lies between two invalid ones of its line."""
    lonely = np.zeros_like(valid)
    lonely[:, 1:-1] = valid[:, 1:-1] & ~valid[:, :-2] & ~valid[:, 2:]
    return lonely
