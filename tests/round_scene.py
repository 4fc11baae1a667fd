"""Test helper: a lidar that turns all round, and sees its own distance at each angle."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import VALID, Beams, FloatArray, LidarSpec, ScanLine
from scan3d_twin.devices.rotating import to_elevation

BLIND = 0.1
"""Half the angle below it in which nothing returns [rad]."""


def true_range(elevations: FloatArray) -> FloatArray:
    """Return the distances [m] at ``elevations`` [rad], in whole millimetres."""
    return np.asarray(np.rint(2000 + 300 * np.cos(elevations - 0.5)) / 1000)


class RoundScene:
    """A ``BeamStream`` with known distances."""

    def __init__(self, clock: Clock, spec: LidarSpec, rate: float, speed: float = 10.0) -> None:
        self.spec = spec
        self._clock, self._rate, self._speed = clock, rate, speed
        self._count = math.floor(clock.now() * rate)

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``: there are none, as emulators of such lidars read beams."""
        raise NotImplementedError

    def seam_before(self, time: float) -> float:
        """Return when the beam last passed behind before ``time`` [s]."""
        return math.floor(time * self._speed) / self._speed

    def read_beams(self) -> Beams:
        """See ``BeamStream.read_beams``."""
        last = math.floor(self._clock.now() * self._rate)
        numbers = np.arange(self._count, last)
        self._count = max(last, self._count)
        times = numbers / self._rate
        elevations = to_elevation(math.tau * self._speed * times - math.pi)
        blind = np.abs(elevations + math.pi / 2) < BLIND
        ranges = np.where(blind, np.nan, true_range(elevations))
        return Beams(times, elevations, ranges, np.where(blind, 0, VALID))
