"""How the simulated URG-04LX errs: every source one parameter, with its unit and its source.

"Logs" are static intervals of real URG-04LX logs; "sibling" is the UBG-04LX-F01, measured at 31
distances and 5 incidences. They give the repeatability. What no measurement backs is named an
assumption. Importing this module costs nothing (no numpy).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from scan3d_twin.sim.checks import at_least_zero, check, within


@dataclass(frozen=True, slots=True)
class LidarModelConfig:
    """The URG-04LX: light, noise, bias, error codes, timing, losses."""

    line_loss: float = 0.0
    """Probability that a line is lost on its way, 0..1."""
    sigma: float = 0.0041
    """Range noise at distance 0, standard deviation [m]; logs: 4.2 to 5.2 mm at 0.5 to 2 m."""
    sigma_per_metre: float = 0.00045
    """Growth of the range noise with distance [m/m]; within the two intervals of the logs."""
    sigma_far: float = 0.0014
    """Step of the range noise from 2.0 to 2.2 m [m]; logs: 6.8 to 7.3 mm at 2 to 4 m; that it is
    the receiver's gain is an assumption."""
    sigma_weak: float = 0.003
    """Range noise of a return at the threshold, added in quadrature [m]; assumption."""
    sigma_incidence: float = 0.75
    """Growth of the range noise with the squared sine of the incidence; sibling: medians of 2.6,
    3.0, 3.9, 3.9, 4.5 mm at 0, 20, 40, 60, 80 deg."""
    neighbours: float = 0.4
    """Correlation of the noise of neighbouring steps, 0..0.5; a beam of 10 mrad shares .4 of its
    light with the next step, 6.1 mrad away."""
    repeats: float = 0.2
    """Probability that a step repeats the reading of the step before, where both lie within their
    noise; assumption, a capture holds runs of equal readings that independent noise does not."""
    bias: float = 0.004
    """Amplitude of the phase measurement's cyclic error [m]; assumption, within the +-10 mm of the
    data sheet."""
    surface_bias: float = 0.003
    """Error that belongs to a surface, standard deviation over surfaces [m]; assumption, within the
    +-10 mm of the data sheet; that colour and material matter: Kneip et al. 2009."""
    warm_up: float = 0.003
    """Error of the cold sensor that fades away [m]; assumption, that it drifts: Kneip et al.
    2009."""
    warm_up_time: float = 1200.0
    """Time constant of the warm-up [s]; assumption."""
    albedo: float = 0.6
    """Diffuse reflectance of the brightest surfaces, 0..1; light grey paint. A darker one has that
    of its red colour, which is nearest to the 785 nm of the laser."""
    roughness: float = 0.6
    """Roughness of surfaces that state none, 0..1 (GGX alpha = roughness squared); matte."""
    threshold: float = 0.0018
    """Weakest return power that is detected, where a white surface at 1 m returns 0.29; 0 detects
    all. Reproduces the data sheet: 10 % grey seen to 4.2 m."""
    softness: float = 0.5
    """Spread of the detection threshold, in ln(power); assumption."""
    saturation: float = 80.0
    """Strongest return power that is measured; assumption, that of a white surface at 60 mm, the
    nearest distance of the data sheet. Beyond: code 18."""
    mixed_phase: float = 0.1
    """Difference of the distances by the two modulations beyond which a reading becomes code 6
    [m]; assumption."""
    mixed_amplitude: float = 2.0
    """Ratio of the amplitudes of the two modulations beyond which a reading becomes code 8;
    assumption."""
    glitch: float = 0.001
    """Probability that a reading becomes code 10, 0..1; assumption, such codes are that rare."""
    sub_rays: int = 5
    """Rays per beam over its footprint, 1 to 16; 1 is a beam without width: no mixed pixels."""
    footprint_along: float = 0.0045
    """Half the beam's width along the line, with the mirror's turn while it measures [rad]; data
    sheet: under 20 mm at 2 m."""
    footprint_across: float = 0.0035
    """Half the beam's width across the line [rad]; as above, without the mirror's turn."""
    revolution: float = 0.0025
    """Relative error of the mirror's speed, standard deviation over sensors; a capture turned in
    99.7 ms, logs in 98 ms."""
    jitter: float = 0.0003
    """Error of the time of step 0, standard deviation over revolutions [s]; assumption, a capture
    shows .4 ms with the jitter of its host."""
    stamp_step: float = 0.001
    """Resolution of the time stamp [s]; SCIP 2.0: milliseconds. 0: exact."""
    latency: float = 0.101
    """From step 0 to the arrival of a line [s]; a capture of firmware 3.1.04 over USB."""

    def __post_init__(self) -> None:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        at_least_zero("lidar", **values)
        within("lidar.line_loss", self.line_loss, 0.0, 0.99)
        within("lidar.glitch", self.glitch, 0.0, 0.99)
        within("lidar.repeats", self.repeats, 0.0, 0.99)
        within("lidar.neighbours", self.neighbours, 0.0, 0.5)
        within("lidar.roughness", self.roughness, 0.01, 1.0)
        within("lidar.albedo", self.albedo, 0.0, 1.0)
        within("lidar.revolution", self.revolution, 0.0, 0.05)
        within("lidar.jitter", self.jitter, 0.0, 0.003)
        within("lidar.stamp_step", self.stamp_step, 0.0, 0.01)
        within("lidar.latency", self.latency, 0.08, 1.0)
        within("lidar.footprint_along", self.footprint_along, 0.0, 0.05)
        within("lidar.footprint_across", self.footprint_across, 0.0, 0.05)
        for name in ("softness", "saturation", "warm_up_time", "mixed_phase"):
            check(values[name] > 0, f"lidar.{name} must be > 0, got {values[name]:g}")
        check(
            self.mixed_amplitude > 1,
            f"lidar.mixed_amplitude must be > 1, got {self.mixed_amplitude:g}",
        )
        within("lidar.sub_rays", self.sub_rays, 1, 16)


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
"""A lidar that errs by its 1 mm resolution only."""

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
