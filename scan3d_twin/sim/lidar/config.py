"""Error model of the simulated URG-04LX: one parameter per error source, with unit and provenance.

"Logs" are static intervals of real URG-04LX logs; "sibling" is the UBG-04LX-F01, measured at 31
distances and 5 incidences. They give the repeatability. A value without a measurement is called an
assumption. This module does not import NumPy, so that the command line starts fast.
"""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.core.options import check_options, number, repr_options


@dataclass(frozen=True, slots=True)
class LidarModelConfig:
    """Light, noise, bias, error codes, timing and losses; the defaults are the URG-04LX."""

    line_loss: float = number(0.0, 0.0, 0.99)
    """Probability that a line is lost on its way, 0..1."""
    sigma: float = number(0.0041, 0.0, 0.5)
    """Range noise at distance 0, standard deviation [m]; logs: 4.2 to 5.2 mm at 0.5 to 2 m."""
    sigma_per_metre: float = number(0.00045, 0.0, 0.5)
    """Growth of the range noise with distance [m/m]; within the two intervals of the logs."""
    sigma_far: float = number(0.0014, 0.0, 0.5)
    """Step of the range noise from 2.0 to 2.2 m [m]; logs: 6.8 to 7.3 mm at 2 to 4 m; assumed to
    come from the receiver's gain."""
    sigma_weak: float = number(0.003, 0.0, 0.5)
    """Range noise of a return at the threshold, added in quadrature [m]; assumption."""
    sigma_incidence: float = number(0.75, 0.0, 100.0)
    """Growth of the range noise with the squared sine of the incidence; sibling: medians of 2.6,
    3.0, 3.9, 3.9, 4.5 mm at 0, 20, 40, 60, 80 deg."""
    neighbours: float = number(0.4, 0.0, 0.5)
    """Correlation of the noise of neighbouring steps, 0..0.5; a beam of 10 mrad shares .4 of its
    light with the next step, 6.1 mrad away."""
    repeats: float = number(0.2, 0.0, 0.99)
    """Probability that a step repeats the reading of the step before, where both lie within their
    noise; assumption, a capture holds runs of equal readings that independent noise does not."""
    bias: float = number(0.004, 0.0, 0.5)
    """Amplitude of the phase measurement's cyclic error [m]; assumption, within the +-10 mm of the
    data sheet."""
    surface_bias: float = number(0.003, 0.0, 0.5)
    """Range bias of a surface, standard deviation over surfaces [m]; assumption, within the +-10 mm
    of the data sheet; it depends on colour and material (Kneip et al. 2009)."""
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
    """Difference of the distances by the two modulations beyond which a reading becomes code 6
    [m]; assumption."""
    mixed_amplitude: float = number(2.0, most=1000.0, above=1.0)
    """Ratio of the amplitudes of the two modulations beyond which a reading becomes code 8;
    assumption."""
    glitch: float = number(0.001, 0.0, 0.99)
    """Probability that a reading becomes code 10, 0..1; assumption, such codes are that rare."""
    sub_rays: int = number(5, 1, 16)
    """Rays per beam over its footprint, 1 to 16; 1 is a beam without width: no mixed pixels."""
    footprint_along: float = number(0.0045, 0.0, 0.05)
    """Half the beam's width along the line, with the mirror's turn while it measures [rad]; data
    sheet: under 20 mm at 2 m."""
    footprint_across: float = number(0.0035, 0.0, 0.05)
    """Half the beam's width across the line [rad]; as above, without the mirror's turn."""
    revolution: float = number(0.0025, 0.0, 0.05)
    """Relative error of the mirror's speed, standard deviation over sensors; a capture turned in
    99.7 ms, logs in 98 ms."""
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


IDEAL_LIDAR = LidarModelConfig(
    sigma=0.0,
    sigma_per_metre=0.0,
    sigma_far=0.0,
    sigma_weak=0.0,
    neighbours=0.0,
    repeats=0.0,
    bias=0.0,
    surface_bias=0.0,
    warm_up=0.0,
    threshold=0.0,
    saturation=1e12,
    glitch=0.0,
    sub_rays=1,
    revolution=0.0,
    jitter=0.0,
    stamp_step=0.0,
)
"""A lidar whose only error is its resolution of 1 mm."""

HARSH_LIDAR = LidarModelConfig(
    line_loss=0.05,
    sigma=0.006,
    repeats=0.3,
    bias=0.006,
    surface_bias=0.006,
    warm_up=0.010,
    albedo=0.4,
    glitch=0.01,
    jitter=0.001,
)
"""A cold sensor on a bad cable: twice the errors of a `typical` one; assumption."""
