"""The footprint of a beam: sub-rays over its width, and the one reading they combine to.

The sensor measures the phase of amplitude-modulated light, so returns from several distances add as
phasors:

    z = sum_k P_k exp(i 4 pi f (r_k - r_0) / c),    distance = r_0 + arg(z) c / (4 pi f)

At a depth edge the result lies between or beside the true distances: a mixed pixel. It differs
between the two modulations; where it differs too much, the firmware reports an error code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray
from scan3d_twin.devices.device import ErrorCodes, LidarSensor
from scan3d_twin.sim.lidar.config import LidarModelConfig

SPEED_OF_LIGHT = 299_792_458.0
MIN_EDGE_DEPTH = 0.02
"""Spread of distances over a footprint beyond which it straddles a depth edge [m]; below it phasors
and the mean weighted by power agree within 1e-5 m."""


def wave_numbers(modulations: tuple[float, float]) -> tuple[float, float]:
    """Return the phase per distance of two ``modulations`` [Hz], in [rad/m]."""
    first, second = (4 * math.pi * f / SPEED_OF_LIGHT for f in modulations)
    return first, second


@dataclass(frozen=True, slots=True)
class Mixed:
    """The received light per beam.

    Attributes:
        distances: Distance by phase (n,) [m]; inf for a miss.
        power: Power of the return (n,); 0 for a miss.
        broken: Indices of beams that straddle a depth edge (n_broken,).
        codes: Error code of each of these beams, or ``VALID`` (n_broken,).
    """

    distances: FloatArray
    power: FloatArray
    broken: IntArray
    codes: IntArray


def offsets(config: LidarModelConfig) -> FloatArray:
    """Return the sub-rays' angles (K, 2) [rad] along and across the line; the first is the centre.

    The others lie on a ring whose second moments equal those of the filled ellipse.
    """
    ring = config.sub_rays - 1
    if ring == 0:
        return np.zeros((1, 2))
    angles = math.tau * (np.arange(ring) + 0.5) / ring
    width = math.sqrt(config.sub_rays / (2 * ring))
    along = width * config.footprint_along * np.cos(angles)
    across = width * config.footprint_across * np.sin(angles)
    return np.vstack([np.zeros((1, 2)), np.stack([along, across], axis=1)])


def mix(
    distances: FloatArray, power: FloatArray, config: LidarModelConfig, sensor: LidarSensor
) -> Mixed:
    """Return what the receiver gets of sub-rays at ``distances`` (K, n) [m] with ``power`` (K, n).

    Misses have infinite distance and zero power.
    """
    none = np.empty(0, np.int64)
    if len(distances) == 1:
        return Mixed(distances[0], power[0], none, none)

    # Find beams at a depth edge
    near, far = distances.min(axis=0), distances.max(axis=0)
    total = power.sum(axis=0)
    edge = np.flatnonzero((far > near + MIN_EDGE_DEPTH) & (total > 0))

    # Average weighted by power
    safe = distances if np.isfinite(far).all() else np.where(power > 0, distances, 0.0)
    mean = (power * safe).sum(axis=0)
    mean /= np.maximum(total, 1e-300)
    mean[near == np.inf] = np.inf
    total /= len(distances)
    if len(edge) == 0 or sensor.modulations is None:
        return Mixed(mean, total, none, none)
    phasors = _phasors(safe[:, edge], power[:, edge], sensor.modulations)
    (mean[edge], _), (total[edge], _) = phasors
    return Mixed(mean, total, edge, _codes(*phasors, config, sensor.codes))


def _phasors(
    distances: FloatArray, power: FloatArray, modulations: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return distance (2, n) [m] and power (2, n) of the sum of the sub-rays, by modulation."""
    waves = np.array(wave_numbers(modulations))[:, None]
    first = distances[np.argmax(power, axis=0), np.arange(distances.shape[1])]
    phases = waves[:, :, None] * (distances - first)
    count = len(distances)
    real, imaginary = ((power * part(phases)).sum(axis=1) / count for part in (np.cos, np.sin))
    return first + np.arctan2(imaginary, real) / waves, np.hypot(real, imaginary)


def _codes(
    distances: FloatArray, power: FloatArray, config: LidarModelConfig, known: ErrorCodes
) -> IntArray:
    """Return the error codes (n,) of beams whose modulations gave these (2, n)."""
    codes = np.full(distances.shape[1], VALID)
    apart: BoolArray = np.abs(distances[0] - distances[1]) > config.mixed_phase
    codes[apart] = known.other_error
    weak, strong = np.minimum(*power), np.maximum(*power)
    codes[strong > config.mixed_amplitude * weak] = known.amplitudes_differ
    return codes
