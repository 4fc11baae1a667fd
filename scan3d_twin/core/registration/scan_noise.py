"""How noisy a sweep is: range noise and yaw jitter, estimated from its own readings.

**Range noise.** Along a line the inverse range of a plane is linear but for terms of second order
in the beam angle, so that its second difference is noise: the median of |d2 q| r^2 / sqrt(6) over
each quarter of the readings by range, and a straight line through the four.

**Yaw jitter.** With e a reading's distance from its surfel along the normal n, l = n . (e_z x P)
what a yaw error of its line makes of it per radian, and w the inverse variance by range noise, a
line by itself errs by d = sum w l e / sum w l^2, of variance 1 / sum w l^2. Of three neighbours
d1 - 2 d2 + d3 has 6 sigma^2 more than follows from that. Only surfels count that are flat across
lines: where the surface bends, its planes are off by themselves.

``native/noise.h`` computes both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import BoolArray, FloatArray, read_only

BIAS_PATCH = np.radians(10.0)
"""Side of a patch of readings that share a range error [rad]: about one face of a thing."""
BIAS_LENGTH = 0.15
"""Way along which a range error changes by itself [m]: 0.26 m for the cycle of 1.6 m of a 46.55 MHz
phase measurement, less at edges and changes of material."""
USUAL = 0.004, 0.0009
"""Range sigma at 0 [m] and its growth per metre of a URG-04LX, where nothing else is known."""


@dataclass(frozen=True, slots=True)
class ScanNoise:
    """Standard deviations of the errors of one sweep.

    Attributes:
        range_sigma: Of a reading at distance 0 [m]; URG-04LX: 4 mm.
        range_sigma_per_metre: Its growth with distance [m/m]; URG-04LX: 0.9 mm/m.
        yaw_sigma: Of a line's yaw about the smooth turn, common to the line's beams [rad].
        yaw_scale_sigma: Of the relative error of all yaws, common to all sweeps of a robot; a wheel
            base known to 1 % gives 0.01.
        bias_sigma: Of the range error that all readings within ``BIAS_PATCH`` share [m].
    """

    range_sigma: float = USUAL[0]
    range_sigma_per_metre: float = USUAL[1]
    yaw_sigma: float = 0.0
    yaw_scale_sigma: float = 0.0
    bias_sigma: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (value >= 0 and math.isfinite(value)):
                raise ConfigError(f"{name} must be >= 0 and finite, got {value:g}")
        if self.range_sigma + self.range_sigma_per_metre == 0:
            raise ConfigError("range_sigma must be > 0 m: readings without noise have no weight")

    @property
    def sigmas(self) -> FloatArray:
        """Range sigma at 0 [m], its growth per metre and the sigma of a line's yaw [rad] (3,)."""
        return read_only([self.range_sigma, self.range_sigma_per_metre, self.yaw_sigma])

    @property
    def tilt_variance(self) -> float:
        """Variance of the tilt [rad2] that a range error makes as it changes along a surface."""
        return (self.bias_sigma / BIAS_LENGTH) ** 2

    def inflation(self, readings: float) -> float:
        """Return the factor on variances when ``readings`` of a patch share a bias.

        The mean of n readings has the variance s^2 / n + b^2 = (s^2 / n) (1 + n b^2 / s^2).
        """
        sigma = self.range_sigma + self.range_sigma_per_metre
        return 1.0 + readings * (self.bias_sigma / sigma) ** 2


def estimate_range_noise(ranges: FloatArray, valid: BoolArray) -> tuple[float, float]:
    """Return ``range_sigma`` and ``range_sigma_per_metre`` of a sweep; as usual if it is too small.

    Args:
        ranges: (n_lines, n_beams) [m].
        valid: Readings that are distances (n_lines, n_beams).
    """
    n_lines, n_beams = ranges.shape
    sweep = native.Sweep(
        n_lines=n_lines, n_beams=n_beams, stride=n_beams, ranges=np.ascontiguousarray(ranges)
    )
    noise = np.empty(2)
    engine.range_noise(sweep, np.ascontiguousarray(valid), noise)
    return float(noise[0]), float(noise[1])
