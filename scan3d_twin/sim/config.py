"""Every knob of the twin: nested frozen dataclasses in SI units, defaults with their source.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
Default is the `typical` robot: each seed draws its own errors from these distributions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.protocols.urg04lx import LINKS

RobotName = Literal["create2"]


def _check(condition: bool, message: str) -> None:
    if not condition:
        raise ConfigError(message)


def _within(name: str, value: float, low: float, high: float) -> None:
    _check(low <= value <= high, f"{name} must be in [{low:g}, {high:g}], got {value:g}")


def _at_least_zero(section: str, **values: float) -> None:
    for name, value in values.items():
        _check(value >= 0 and math.isfinite(value), f"{section}.{name} must be >= 0, got {value:g}")


@dataclass(frozen=True, slots=True)
class LidarModelConfig:
    """The URG-04LX: noise, dropouts, losses."""

    line_loss: float = 0.0
    """Probability that a line is lost on its way, 0..1."""
    sigma: float = 0.004
    """Range noise at distance 0, standard deviation [m]; real logs: 4.2 to 5.2 mm at 0.5 to 2 m."""
    sigma_per_metre: float = 0.0009
    """Growth of the range noise with distance [m/m]; real logs: 6.8 to 7.3 mm at 2 to 4 m."""
    sigma_weak: float = 0.004
    """Range noise of a return at the threshold, added in quadrature [m]; assumption."""
    bias: float = 0.004
    """Amplitude of the phase measurement's cyclic error [m]; assumption, within the +-10 mm of the
    data sheet."""
    albedo: float = 0.6
    """Diffuse reflectance of surfaces that state no other, 0..1; light grey paint."""
    roughness: float = 0.6
    """Roughness of surfaces that state none, 0..1 (GGX alpha = roughness squared); matte."""
    threshold: float = 0.0018
    """Weakest return power that is detected, where a white surface at 1 m returns 0.29; 0 detects
    all. Reproduces the data sheet: 10 % grey seen to 4.2 m."""
    softness: float = 0.5
    """Spread of the detection threshold, in ln(power); assumption."""
    sub_rays: int = 1
    """Rays per beam over its footprint; 1 is a beam without width."""

    def __post_init__(self) -> None:
        _within("lidar.line_loss", self.line_loss, 0.0, 0.99)
        _within("lidar.roughness", self.roughness, 0.01, 1.0)
        _within("lidar.albedo", self.albedo, 0.0, 1.0)
        _check(self.softness > 0, f"lidar.softness must be > 0, got {self.softness:g}")
        _check(self.sub_rays == 1, f"lidar.sub_rays must be 1, got {self.sub_rays}")
        _at_least_zero(
            "lidar",
            sigma=self.sigma,
            sigma_per_metre=self.sigma_per_metre,
            sigma_weak=self.sigma_weak,
            bias=self.bias,
            threshold=self.threshold,
        )


IDEAL_LIDAR = LidarModelConfig(
    sigma=0.0, sigma_per_metre=0.0, sigma_weak=0.0, bias=0.0, threshold=0.0
)
"""A lidar that errs by its 1 mm resolution only."""


@dataclass(frozen=True, slots=True)
class RobotErrorConfig:
    """How far a robot is from its nominal self; drawn once per seed.

    Wheel errors and friction give 1.9 deg/m of heading drift and .8 deg in a 90 deg turn (standard
    deviations), typical of the Create; MuJoCo's slip alone gives a tenth of that.
    """

    wheel_radius: float = 0.006
    """Relative error of each wheel's radius, standard deviation; tyre wear and load."""
    wheel_base: float = 0.01
    """Relative error of the wheel base, standard deviation; contact patch of the tyres."""
    friction_min: float = 0.5
    """Lowest sliding friction of the tyres; smooth floor."""
    friction_max: float = 0.9
    """Highest sliding friction of the tyres; carpet."""
    cogging: float = 0.03
    """Amplitude of the wheel torque's cogging [N m]; .02 to .04 shake the scan plane by .01 deg."""

    def __post_init__(self) -> None:
        _within("errors.wheel_radius", self.wheel_radius, 0.0, 0.05)
        _within("errors.wheel_base", self.wheel_base, 0.0, 0.05)
        _within("errors.cogging", self.cogging, 0.0, 0.1)
        _check(
            0 < self.friction_min <= self.friction_max <= 2,
            "errors.friction_min and errors.friction_max must be in (0, 2], in this order,"
            f" got {self.friction_min:g} and {self.friction_max:g}",
        )


IDEAL_ROBOT = RobotErrorConfig(
    wheel_radius=0.0, wheel_base=0.0, friction_min=0.7, friction_max=0.7, cogging=0.0
)
"""A robot that is exactly its data sheet; it still slips as the physics has it."""


@dataclass(frozen=True, slots=True)
class TwinConfig:
    """The twin of the robot, its lidar and their errors."""

    robot: RobotName = "create2"
    """Robot profile."""
    lidar_link: str = "usb"
    """How the lidar is connected: usb (682 steps, 10 Hz), 115200 (357 steps, 10 Hz) or 115200-full
    (682 steps, 5 Hz)."""
    lidar: LidarModelConfig = field(default_factory=LidarModelConfig)
    errors: RobotErrorConfig = field(default_factory=RobotErrorConfig)

    def __post_init__(self) -> None:
        _check(self.robot == "create2", f"robot must be create2, got {self.robot!r}")
        if self.lidar_link not in LINKS:
            raise UnknownNameError("lidar link", self.lidar_link, LINKS)

    @classmethod
    def ideal(cls, lidar_link: str = "usb") -> TwinConfig:
        """Return a robot and a lidar without errors, for tests."""
        return cls(lidar_link=lidar_link, lidar=IDEAL_LIDAR, errors=IDEAL_ROBOT)
