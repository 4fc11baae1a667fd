"""Noise model of a sweep: range noise and yaw jitter, estimated from its own readings.

**Range noise.** Along a line, the inverse range of a plane is linear in the beam angle up to
second-order terms, so its second difference is noise. The median of |d2 q| r^2 / sqrt(6) is taken
over each quartile of the readings by range, and a straight line fitted through the four. Where the
lines have elevations of their own, the difference allows for uneven spacing.

**Yaw jitter.** Let e be a reading's distance from its surfel along the normal n, l = n . (e_z x P)
its derivative by the yaw of its line, and w the inverse variance by range noise. A single line then
has the yaw error d = sum w l e / sum w l^2, of variance 1 / sum w l^2. The second difference
d1 - 2 d2 + d3 of three neighbours exceeds the variance that follows from this by 6 sigma^2. Only
surfels on surfaces flat across lines count: on curved ones the planes are biased.

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
"""Side of a patch of readings that share a range error [rad]: about one face of an object."""
BIAS_LENGTH = 0.15
"""Correlation length of a range error [m]: 0.26 m for the 1.6 m cycle of a 46.55 MHz phase
measurement, less at edges and changes of material."""
URG_RANGE_NOISE = 0.004, 0.0009
"""Range sigma of a URG-04LX at 0 m [m] and its growth per metre, used where it is not estimated."""


@dataclass(frozen=True, slots=True)
class ScanNoise:
    """Standard deviations of the errors of one sweep.

    Attributes:
        range_sigma: Range noise at distance 0 [m]; URG-04LX: 4 mm.
        range_sigma_per_metre: Its growth with distance [m/m]; URG-04LX: 0.9 mm/m.
        yaw_sigma: Yaw jitter of a line about the smooth turn, shared by its beams [rad].
        yaw_scale_sigma: Relative error of all yaws, shared by all sweeps of a robot; a wheel base
            known to 1 % gives 0.01.
        bias_sigma: Range error that all readings within ``BIAS_PATCH`` share [m].
    """

    range_sigma: float = URG_RANGE_NOISE[0]
    range_sigma_per_metre: float = URG_RANGE_NOISE[1]
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
        """Range sigma at 0 m [m], its growth per metre and the sigma of a line's yaw [rad] (3,)."""
        return read_only([self.range_sigma, self.range_sigma_per_metre, self.yaw_sigma])

    @property
    def tilt_variance(self) -> float:
        """Variance of a surface's tilt by a range error that changes along it [rad2]."""
        return (self.bias_sigma / BIAS_LENGTH) ** 2

    def inflation(self, readings: float) -> float:
        """Return the inflation factor of variances when ``readings`` of a patch share a bias.

        The mean of n readings has the variance s^2 / n + b^2 = (s^2 / n) (1 + n b^2 / s^2).
        """
        sigma = self.range_sigma + self.range_sigma_per_metre
        return 1.0 + readings * (self.bias_sigma / sigma) ** 2


def estimate_range_noise(
    ranges: FloatArray, valid: BoolArray, rays: FloatArray | None = None
) -> tuple[float, float]:
    """Return ``range_sigma`` and ``range_sigma_per_metre`` estimated from a sweep.

    A sweep with too few readings gives ``URG_RANGE_NOISE``.

    Args:
        ranges: Ranges (n_lines, n_beams) [m].
        valid: Whether a reading is a distance (n_lines, n_beams).
        rays: Directions of the beams in ``base`` where the lines have elevations of their own
            (n_lines, n_beams, 3); None where beams are evenly spaced.
    """
    n_lines, n_beams = ranges.shape
    sweep = native.Sweep(
        n_lines=n_lines, n_beams=n_beams, stride=n_beams, ranges=np.ascontiguousarray(ranges),
        rays=rays, ray_stride=0 if rays is None else 3 * n_beams,
    )  # fmt: skip
    noise = np.empty(2)
    engine.estimate_range_noise(sweep, np.ascontiguousarray(valid), noise)
    return float(noise[0]), float(noise[1])
