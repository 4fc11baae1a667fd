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


WEAK_SHARE = 0.5
"""Share of the threshold above which a return that is not detected has the code of a weak one;
assumption."""
FIRST_CODE = 1e6
"""Internal distance of code 0 [mm]; that of the code k is k more. Beyond all distances, so that the
median takes what was not measured as far away; see ``median_of_five``."""


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
    if config.dropout > 0:
        seen &= np.abs(draws.chance - 0.5) >= config.dropout / 2
    distances = np.where(seen, light.distances, 0.0)
    sigma = range_sigma(distances, power, light.cosines, config)
    readings = cyclic_bias(distances, config, sensor)
    readings += distances + light.bias + drift[:, None] + sigma * draws.noise
    readings = repeat_readings(readings, sigma, draws.chance, config)

    # Round and check each step
    internal = np.rint(readings * 1000)
    valid = seen & (internal >= sensor.min_range_mm) & (internal <= sensor.max_range_mm)
    codes = np.where(seen & (internal > sensor.detected_range_mm), known.too_far, known.no_return)
    if config.threshold > 0:
        codes[~seen & (power > WEAK_SHARE * config.threshold)] = known.weak_return
    at, mixed = broken
    if len(mixed):
        unusable = mixed != VALID
        at = at[0][unusable], at[1][unusable]
        codes[at] = np.where(valid[at], mixed[unusable], codes[at])
        valid[at] = False
    if power.max() > config.saturation:
        strong = power > config.saturation
        codes[strong], valid[strong] = known.too_strong, False
    isolated = _is_isolated(valid) if sensor.drops_isolated else np.zeros_like(valid)

    # Filter along the line
    if config.running_median:
        internal = median_of_five(np.where(valid, internal, FIRST_CODE + codes))
        codes = (internal - FIRST_CODE).astype(np.int64)
        valid = internal < FIRST_CODE
    codes[valid] = VALID

    # Mark what the filter does not mend
    if config.glitch > 0:
        codes[valid & (draws.chance > 1 - config.glitch)] = known.glitch
    codes[isolated] = known.neighbours_invalid
    return np.where(codes == VALID, internal / 1000, np.nan), codes


def median_of_five(values: FloatArray) -> FloatArray:
    """Return the running median of ``values`` (m, n >= 3) over five steps.

    The window is cut at the ends of a line by repeating its first and last value.
    """
    m, n = values.shape
    padded = np.empty((m, n + 4))
    padded[:, 2:-2] = values
    padded[:, :2], padded[:, -2:] = values[:, :1], values[:, -1:]

    # Order the pairs on both sides of the middle
    low = np.minimum(padded[:, 1:], padded[:, :-1])
    high = np.maximum(padded[:, 1:], padded[:, :-1])
    lower = np.maximum(low[:, :n], low[:, 3:])
    upper = np.minimum(high[:, :n], high[:, 3:])

    # Take the median of the three that remain
    result = np.maximum(np.minimum(lower, upper), np.minimum(np.maximum(lower, upper), values))
    return np.asarray(result)


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
