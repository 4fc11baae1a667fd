"""Noise model of a sweep: range noise, its correlation and yaw jitter, from its own readings.

Across seven lines, at one beam, the inverse range q of a plane is linear in the yaw up to
second-order terms. Its sixth difference D is noise of variance 924 s^2 / r^4, and far less of a
curve than of noise: a wave of 9 lines leaves 1 / 57 of what a second difference leaves. Lines
are independent of each other, readings of a line are not. Of unevenly spaced lines D is what is
left of the sixth difference without the powers of the yaw up to the fourth, scaled to the same
variance. The slope of the range over the yaw has no noise in common with D: where it is mostly
noise, the two would look like a yaw error.

**Range noise.** The median of |D| r^2 / sqrt(924) is taken over each quartile of the readings by
range, and a straight line fitted through the four.

A difference across the end of a surface is not noise: a single reading of what is behind, at the
end of the seven lines, would pass for a yaw error, the same at all heights. Where the range steps
off its slope by more than four standard deviations of range noise and a jitter of 0.1 deg from one
line to the next, D takes no part in correlation and jitter.

**Correlation.** Neighbouring beams share light and a filter, so that a mean along a line is less
precise than of independent readings by 1 + 2 sum rho_k. The rho_k are those of D along the line,
less what beams ten apart have in common: the yaw error of their lines.

**Yaw jitter.** The yaw error d of a line moves its readings by d times the slope of the range over
the yaw. With S the sum of a line's squared slopes and S' what of it is not their noise, the turn
sum slope D / S' has the variance g sigma^2 + 924 c k s^2 S / S'^2, with g what the yaw errors of
the seven lines add up to. The excess over the second term, weighted over all lines with S' > S / 5,
is sigma^2; squares count up to twice what is expected, as some lines lie on bends. The factor k is
by how much the noise exceeds s^2 where slopes are large, from what the regressions leave (White,
Econometrica 48, 1980). Incidences beyond 60 deg take no part: most are limbs of round bodies, where
noise is 3 to 10 times s. Before the sweep is seen sigma^2 is (0.1 deg)^2 in the mean, exponentially
distributed (an assumption); the mean of the posterior, nearly, is taken, so that jitter which the
noise may hide is not zero: 0.08 deg where lines tell nothing. Fewer than ten lines give none.

``native/noise.h``, ``differences.h`` and ``yaw_jitter.h`` compute this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.extraction import make_native_sweep
from scan3d_twin.core.types import BoolArray, FloatArray, RangeImage, read_only

BIAS_PATCH = np.radians(10.0)
"""Side of a patch of readings that share a range error [rad]: about one face of an object."""
BIAS_LENGTH = 0.15
"""Correlation length of a range error [m]: 0.26 m for the 1.6 m cycle of a 46.55 MHz phase
measurement, less at edges and changes of material."""
CURVE_RANGES = read_only(0.25 * np.arange(24))
"""Ranges at which the curve of the range error has its knots [m]; constant beyond. As in
``native/shared_errors.h``."""
CURVE_LENGTH = 0.25
"""Range over which that curve changes [m]: a sixth of the 1.6 m cycle named at ``BIAS_LENGTH``."""
MIN_CURVE_SIGMA = 1e-4
"""Independent part of the knots' errors, which keeps their covariance regular [m]."""
URG_RANGE_NOISE = 0.004, 0.0009
"""Range sigma of a URG-04LX at 0 m [m] and its growth per metre, used where it is not estimated."""


NOISE_UNKNOWN = read_only([math.nan] * 4)
"""Stands for noise that the engine estimates."""


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
        linearity_sigma: Range error that depends on the range only, the same in all sweeps [m].
        offset_sigma: Range error that all readings share, the same in all sweeps [m].
        correlation: Factor on the variance of a mean of many readings, as neighbours on a line have
            correlated noise: 1 + 2 sum rho_k.
    """

    range_sigma: float = URG_RANGE_NOISE[0]
    range_sigma_per_metre: float = URG_RANGE_NOISE[1]
    yaw_sigma: float = 0.0
    yaw_scale_sigma: float = 0.0
    bias_sigma: float = 0.0
    linearity_sigma: float = 0.0
    offset_sigma: float = 0.0
    correlation: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"{name} must be >= 0 and finite, got {value:g}")
        if self.range_sigma + self.range_sigma_per_metre == 0:
            raise ConfigError("range_sigma must be > 0 m: readings without noise have no weight")
        if self.correlation < 1.0:
            raise ConfigError(f"correlation must be >= 1, got {self.correlation}")

    @staticmethod
    def of(found: FloatArray) -> ScanNoise:
        """Return the noise of which the engine has ``found`` what a sweep shows (4,)."""
        range_sigma, growth, yaw_sigma, correlation = found.tolist()
        return ScanNoise(range_sigma, growth, yaw_sigma, correlation=correlation)

    def range_sigma_at(self, distance: float) -> float:
        """Return the range noise [m] at a distance [m]."""
        return self.range_sigma + self.range_sigma_per_metre * distance

    def with_range_noise_of(self, other: ScanNoise) -> ScanNoise:
        """Return this noise with the range noise of another sweep."""
        return replace(
            self,
            range_sigma=other.range_sigma,
            range_sigma_per_metre=other.range_sigma_per_metre,
        )

    @property
    def values(self) -> FloatArray:
        """Range sigma at 0 m [m], its growth per metre, yaw sigma [rad], correlation (4,)."""
        sigmas = [self.range_sigma, self.range_sigma_per_metre, self.yaw_sigma]
        return read_only([*sigmas, self.correlation])

    @property
    def curve_covariance(self) -> FloatArray:
        """Covariance (24, 24) of the range error at ``CURVE_RANGES`` [m2].

        linearity^2 / (1 + d^2 / (2 l^2)) + offset^2, with d the difference of two ranges and l
        ``CURVE_LENGTH``.
        """
        apart = (CURVE_RANGES[:, None] - CURVE_RANGES) / CURVE_LENGTH
        smooth = self.linearity_sigma**2 / (1.0 + apart**2 / 2.0) + self.offset_sigma**2
        return np.asarray(smooth + MIN_CURVE_SIGMA**2 * np.eye(len(CURVE_RANGES)))

    @property
    def tilt_variance(self) -> float:
        """Variance of a surface's tilt by a range error that changes along it [rad2]."""
        return (self.bias_sigma / BIAS_LENGTH) ** 2

    def inflation(self, readings: float) -> float:
        """Return the inflation factor of variances when ``readings`` of a patch share a bias.

        The mean of n readings has the variance c s^2 / n + b^2 = (s^2 / n) (c + n b^2 / s^2), with
        c the factor for correlation.
        """
        sigma = self.range_sigma + self.range_sigma_per_metre
        return self.correlation + readings * (self.bias_sigma / sigma) ** 2


def estimate_noise(image: RangeImage, valid: BoolArray) -> ScanNoise:
    """Return range noise, its correlation and yaw jitter estimated from a sweep.

    A sweep with too few readings gives ``URG_RANGE_NOISE``, no correlation and no jitter, and one
    with fewer than ten lines that could show jitter none of it.

    Args:
        image: The sweep.
        valid: Whether a reading is a distance (n_lines, n_beams).
    """
    noise = NOISE_UNKNOWN.copy()
    if engine.estimate_noise(make_native_sweep(image), np.ascontiguousarray(valid), noise) < 0:
        raise MemoryError
    return ScanNoise.of(noise)
