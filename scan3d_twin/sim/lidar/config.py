"""Error model of the simulated URG-04LX: one parameter per error source, with unit and provenance.

"The log" is that of a standing URG-04LX to which ``benchmarks/sensor_statistics.py`` compares the
twin. What it gives are three errors of a single step (noise, direction, loss), of which the
firmware's running median over five steps makes readings: 2.6 mm of noise where a wall is seen
frontally, twice as much where it is seen at 45 deg, as the median then has fewer equals to choose
from, and equal neighbours. A value without a measurement is called an assumption. This module does
not import NumPy, so that the command line starts fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from scan3d_twin.core.options import check_options, number, repr_options

MEDIAN_SIGMA = 0.59
"""Standard deviation of the running median of five in units of its values', which have the
correlation ``neighbours`` of .2; .54 without (simulated, 1e5 lines of a flat wall)."""


@dataclass(frozen=True, slots=True)
class LidarModelConfig:
    """Light, noise, bias, error codes, timing and losses; the defaults are the URG-04LX."""

    line_loss: float = number(0.0, 0.0, 0.99)
    """Probability that a line is lost on its way, 0..1."""
    sigma: float = number(0.0043, 0.0, 0.5)
    """Range noise of a step before the running median, standard deviation [m]; fitted to the log,
    whose readings have 2.6 mm at 1 to 2 m and up to 30 deg of incidence."""
    sigma_per_metre: float = number(0.0, 0.0, 0.5)
    """Growth of the range noise with distance [m/m]; the log shows none besides ``pointing``."""
    sigma_far: float = number(0.0, 0.0, 0.5)
    """Step of the range noise from 2.0 to 2.2 m [m]; only for the world ``unfiltered``."""
    sigma_weak: float = number(0.003, 0.0, 0.5)
    """Range noise of a return at the threshold, added in quadrature [m]; assumption."""
    sigma_incidence: float = number(0.0, 0.0, 100.0)
    """Growth of the range noise with the squared sine of the incidence; only for the world
    ``unfiltered``: the growth that the log shows comes of ``pointing`` and the running median."""
    pointing: float = number(0.003, 0.0, 0.05)
    """Random error of a step's direction along the line, standard deviation [rad]; fitted to the
    log, whose readings have 5.4 mm at 1 to 2 m and 30 to 60 deg, and whose edges flicker."""
    neighbours: float = number(0.2, 0.0, 0.5)
    """Correlation of the noise of neighbouring steps before the running median, 0..0.5; fitted to
    the log's correlation along the beams. A beam of 10 mrad shares .4 of its light with the next
    step, 6.1 mrad away."""
    repeats: float = number(0.0, 0.0, 0.99)
    """Probability that a step repeats the reading of the step before, where both lie within their
    noise; only for the world ``unfiltered``: the running median repeats readings."""
    dropout: float = number(0.024, 0.0, 0.5)
    """Probability that a step measures nothing, whatever comes back. In the log .06 % of the
    readings of bright, smooth surfaces nearer than 2 m have the code of two lost neighbours: the
    square of it."""
    running_median: bool = True
    """Whether the firmware takes the median of five neighbouring steps; the log shows it, see
    ``firmware.median_of_five``."""
    bias: float = number(0.004, 0.0, 0.5)
    """Amplitude of the phase measurement's cyclic error [m]; assumption, within the +-10 mm of the
    data sheet."""
    surface_bias: float = number(0.003, 0.0, 0.5)
    """Range bias of a surface, standard deviation over surfaces [m]; assumption, within the +-10 mm
    of the data sheet; it depends on colour and material (Kneip et al. 2009)."""
    unit_offset: float = number(0.0, 0.0, 0.5)
    """Range error of a sensor that stays, standard deviation over sensors [m]; the log of one
    URG-04LX cannot tell it from ``surface_bias``."""
    warm_up: float = number(0.003, 0.0, 0.5)
    """Range error of the cold sensor, which decays [m]; assumption; that it drifts: Kneip et al.
    2009."""
    warm_up_time: float = number(1200.0, most=1e6)
    """Time constant of the warm-up [s]; assumption."""
    albedo: float = number(0.6, 0.0, 1.0)
    """Diffuse reflectance of the brightest surfaces, 0..1; light grey paint. A darker surface has
    the reflectance of its red colour, nearest to the 785 nm of the laser."""
    roughness: float = number(0.6, 0.01, 1.0)
    """Roughness of surfaces that state none, 0..1 (GGX alpha = roughness squared); matte."""
    threshold: float = number(0.0018, 0.0, 1000.0)
    """Weakest return power that is detected, where a white surface at 1 m returns 0.29; 0 detects
    all. Reproduces the data sheet: 10 % grey seen to 4.2 m."""
    softness: float = number(0.5, most=10.0)
    """Spread of the detection threshold, in ln(power); assumption."""
    saturation: float = number(80.0, most=1e12)
    """Strongest return power that is measured; assumption, that of a white surface at 60 mm, the
    nearest distance of the data sheet. Beyond: code 18."""
    mixed_phase: float = number(0.1, most=10.0)
    """Difference of the distances by the two modulations beyond which a step measures nothing [m];
    assumption."""
    mixed_amplitude: float = number(2.0, most=1000.0, above=1.0)
    """Ratio of the amplitudes of the two modulations beyond which a reading becomes code 8;
    assumption."""
    glitch: float = number(0.001, 0.0, 0.99)
    """Probability that a reading becomes code 10, 0..1; the log: .08 %."""
    sub_rays: int = number(5, 1, 16)
    """Rays per beam over its footprint, 1 to 16; 1 is a beam without width: no mixed pixels."""
    footprint_along: float = number(0.0045, 0.0, 0.05)
    """Half the beam's width along the line, with the mirror's turn while it measures [rad]; data
    sheet: under 20 mm at 2 m."""
    footprint_across: float = number(0.0035, 0.0, 0.05)
    """Half the beam's width across the line [rad]; as above, without the mirror's turn."""
    period_error: float = number(-0.0115, -0.05, 0.05)
    """Mean relative error of the mirror's period, nominally 100 ms; the log: 98.8 ms."""
    revolution: float = number(0.0045, 0.0, 0.05)
    """Relative error of the mirror's period about this mean, standard deviation over sensors; a
    capture of another sensor turned in 99.7 ms."""
    sway: float = number(0.0, 0.0, 0.02)
    """Yaw of the lidar on its mast, standard deviation over lines [rad]; 0: the mast is stiff. The
    kinematic robot of the environments has none."""
    jitter: float = number(0.0003, 0.0, 0.003)
    """Error of the time of step 0, standard deviation over revolutions [s]; assumption, a capture
    shows .4 ms with the jitter of its host."""
    stamp_step: float = number(0.001, 0.0, 0.01)
    """Resolution of the time stamp [s]; SCIP 2.0: milliseconds. 0: exact."""
    latency: float = number(0.101, 0.08, 1.0)
    """Delay from step 0 to the arrival of a line [s]; a capture of firmware 3.1.04 over USB."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "lidar")

    def for_single_beams(self) -> LidarModelConfig:
        """Return the model of beams that are not neighbours: without what neighbours share.

        Without the running median the noise is that of its result on a wall seen frontally; a beam
        of one ray has no mixed pixels.
        """
        sigma = self.sigma * (MEDIAN_SIGMA if self.running_median else 1.0)
        return replace(
            self, sigma=sigma, neighbours=0.0, repeats=0.0, dropout=0.0, running_median=False,
            sub_rays=1,
        )  # fmt: skip


IDEAL_LIDAR = LidarModelConfig(
    sigma=0.0,
    sigma_per_metre=0.0,
    sigma_far=0.0,
    sigma_weak=0.0,
    neighbours=0.0,
    repeats=0.0,
    pointing=0.0,
    dropout=0.0,
    running_median=False,
    bias=0.0,
    surface_bias=0.0,
    warm_up=0.0,
    threshold=0.0,
    saturation=1e12,
    glitch=0.0,
    sub_rays=1,
    period_error=0.0,
    revolution=0.0,
    jitter=0.0,
    stamp_step=0.0,
)
"""A lidar whose only error is its resolution of 1 mm."""

HARSH_LIDAR = LidarModelConfig(
    line_loss=0.05,
    sigma=0.0086,
    pointing=0.005,
    dropout=0.05,
    bias=0.006,
    surface_bias=0.006,
    warm_up=0.010,
    albedo=0.4,
    glitch=0.01,
    jitter=0.001,
)
"""A cold sensor on a bad cable: up to twice the errors of a `typical` one; assumption."""

UNFILTERED_LIDAR = LidarModelConfig(
    sigma=0.0041,
    sigma_per_metre=0.00045,
    sigma_far=0.0014,
    sigma_incidence=0.75,
    pointing=0.0,
    neighbours=0.4,
    repeats=0.2,
    dropout=0.0,
    running_median=False,
    period_error=0.0,
    revolution=0.0025,
)
"""The noise that this project assumed up to its commit e3444ed, to compare figures with older ones.

It takes the noise of all incidences for that of a wall seen frontally, and multiplies it by the
growth with incidence of a UBG-04LX-F01 (medians of 2.6 to 4.5 mm at 0 to 80 deg) once more: almost
twice the noise of the log, in less correlated readings.
"""
