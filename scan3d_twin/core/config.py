"""The options of a run: nested frozen dataclasses in SI units, defaults with their source.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
The docstring below a field is its help text; invalid values are refused, never repaired. Those of
planning are in ``planning_config.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, get_args

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.options import (
    check_options,
    field_name,
    number,
    option_key,
    renamed,
    repr_options,
)
from scan3d_twin.core.planning_config import BaselineConfig, PlanningConfig
from scan3d_twin.core.presets import DEFAULT_PRESET, PAPER, PRESETS

Pattern = Literal["yaw-base", "yaw", "pitch", "roll"]
PATTERNS: tuple[str, ...] = get_args(Pattern)
"""The ways to turn the plane of the lidar (``core/scanning/patterns.py``)."""
Tour = Literal["front", "full"]
Resource = Literal["speed", "memory"]
Scope = Literal["target", "sweep"]
Extraction = Literal["salient", "everything"]
Turning = Literal["odometry", "look"]
Border = Literal["drop", "keep"]
Engine = Literal["icp", "grid"]
AlignmentMode = Literal["off", "loop_closure"]
Misfits = Literal["keep", "drop"]


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Turning on the spot while the scan lines sweep out a 3D image (paper section 3)."""

    width: float = number(math.radians(90.0), most=math.tau)
    """Horizontal angle of a sweep, the paper's C [rad]; 60 deg in the paper. To 45 deg from its
    middle, lines of 0.5 deg are 17 mm apart on a flat front at the standoff of 1 m."""
    margin: float = number(math.radians(30.0), 0.0, math.pi)
    """Angle swept beyond the width on either side, for registration and the model only [rad]."""
    yaw_rate: float = number(math.radians(5.0), most=2.0)
    """Turn rate of a sweep [rad/s]; 5 deg/s at 10 Hz puts the lines 0.5 deg apart."""
    look_rate: float = number(math.radians(20.0), most=4.0)
    """Turn rate of a panorama [rad/s]; 2 deg between lines are enough to find a target."""
    turning: Turning = "look"
    """Source of the angle turned: odometry as it is, or corrected by the first panorama (look),
    whose two ends must meet."""
    settle: float = number(0.3, 0.0, 60.0)
    """Rest before a sweep until the mast is still [s]: several of its periods (11 to 18 Hz)."""
    retries: int = number(5, 0, 1000)
    """Number of further passes over missing lines before the run gives up."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "sweep")
        if self.width + 2 * self.margin > math.tau:
            raise ConfigError(
                f"sweep.width + 2 sweep.margin must be <= 2 pi rad, got {self.width:g} and "
                f"{self.margin:g}"
            )


@dataclass(frozen=True, slots=True)
class MountConfig:
    """Extrinsics: how the lidar's mount differs from the designed one; 0 is as designed.

    `twin calibrate lidar` finds small errors. A lidar may also be mounted otherwise: turned by yaw,
    then pitch, then roll, of any size.
    """

    lateral: float = number(0.0, -0.2, 0.2)
    """Offset of the lidar to the left [m]."""
    roll: float = number(0.0, -math.pi, math.pi)
    """Lean of the lidar to its right, about the axis ahead [rad]."""
    pitch: float = number(0.0, -math.pi, math.pi)
    """Tilt of the lidar downwards, about the axis to the left [rad]."""
    yaw_scale: float = number(0.0, -0.2, 0.2)
    """Relative error of turns: the robot turns by this share more than odometry measures."""
    time_offset: float = number(0.0, -1.0, 1.0)
    """Delay of the readings relative to their timestamps [s]."""
    yaw: float = number(0.0, -math.pi, math.pi)
    """Turn of the lidar to the left, about the vertical axis [rad]; calibrated where a turntable
    rolls it."""
    play: float = number(0.0, -0.2, 0.2)
    """Play of the turntable beyond the nominal one, which its driver takes off [rad]."""
    axis_roll: float = number(0.0, -0.2, 0.2)
    """Lean of the turntable's axis to the right of the robot, against the floor [rad]."""
    axis_pitch: float = number(0.0, -0.2, 0.2)
    """Tilt of the turntable's axis forwards, against the floor [rad]."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "mount")


@dataclass(frozen=True, slots=True)
class GapConfig:
    """Gap filling (paper section 4.1)."""

    max_angle: float = number(math.radians(3.0), most=math.pi)
    """Widest gap that is filled, along a line or across lines [rad]."""
    depth_edge: float = number(0.04, most=10.0)
    """Difference of neighbouring ranges above which they are on different surfaces [m]; 4 sigma at
    4 m."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "gaps")


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """Target extraction (paper section 4.2)."""

    window: float = number(math.radians(75.0), most=math.tau)
    """Vertical field of view that is modelled, centred on the horizontal [rad]; paper section 4.2:
    75 deg."""
    max_range: float = number(4.0, most=100.0)
    """Longest range that is used [m]; URG-04LX data sheet."""
    floor_height: float = number(0.03, 0.0, 1.0)
    """Height below which points are floor, from 2 m on, and half of it at 0.6 to 1 m [m]; an error
    of the mount of 0.5 deg is 17 mm at 2 m."""
    cluster_gap: float = number(0.20, most=10.0)
    """Distance in the top view below which two things are one target [m]."""
    min_points: int = number(30, 1, 1_000_000)
    """Number of points below which a group is stray points."""
    extraction: Extraction = "salient"
    """What is modelled: the salient target, or everything within reach, with floor and walls, in
    views of a scanner that is set down by hand."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "target")


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Registration of two views (paper eq. 1)."""

    scope: Scope = "sweep"
    """Points that are registered: only the target's as in the paper, or the whole sweep's."""
    max_correspondence_distance: float = number(0.10, most=10.0)
    """Largest distance of two points that correspond [m]."""
    engine: Engine = "grid"
    """Method: the paper's point-to-point ICP, or point-to-plane on a grid of surfels."""
    bias_sigma: float = number(0.001, 0.0, 0.1)
    """Standard deviation of the range error that neighbouring readings share, for the grid engine
    [m]; within the +-10 mm of the URG-04LX's data sheet."""
    linearity_sigma: float = number(0.003, 0.0, 0.1)
    """Standard deviation of the range error that depends on the range only, for the grid engine
    [m]; with those beside it within the +-10 mm of the URG-04LX's data sheet."""
    offset_sigma: float = number(0.002, 0.0, 0.1)
    """Standard deviation of the range error that all readings share, for the grid engine [m]; a
    cold sensor drifts by several millimetres (Kneip et al. 2009)."""
    reading_sigma: float = number(0.0027, 0.0, 0.1)
    """Noise that a good sensor of this kind has on surfaces seen frontally up to 3 m, standard
    deviation [m], for a warning where readings scatter more; a URG-04LX: 2.65 mm (95 % of it: 2.32
    to 3.41) in the log of a standing one (benchmarks/sensor_statistics.py). 0: not known."""
    starts: int = number(16, 1, 1000)
    """Number of starting poses of the grid engine, spread over the odometry's error."""
    yaw_scale_sigma: float = number(0.01, 0.0, 0.2)
    """Standard deviation of the relative error of all yaws, for the grid engine: the wheel base is
    known to 1 %."""
    calibration: float = number(1.7, most=100.0)
    """Factor on a registration's predicted error, which the true one exceeds with a probability of
    at most 10 %, for the grid engine; benchmarks/calibrate_error.py on random:2000 to random:2059
    (1.70 from 237 steps; exceeded by 9.8 % of 234 steps of a later build)."""
    border: Border = "drop"
    """Pairs on the border of the target scan, beyond which the surface goes on unseen: drop or keep
    them."""
    max_iterations: int = number(100, 1, 100_000)
    """Largest number of iterations of ICP."""
    translation_epsilon: float = number(5e-5)
    """Step length below which ICP has converged, with rotation_epsilon [m]."""
    rotation_epsilon: float = number(5e-5)
    """Step rotation below which ICP has converged, with translation_epsilon [rad]."""
    max_points: int = number(3000, 1, 10_000_000)
    """Largest number of source points of a registration; more are thinned out evenly."""
    min_fitness: float = number(0.3)
    """Smallest share of source points with a correspondence in a valid registration."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "registration")


@dataclass(frozen=True, slots=True)
class AlignmentConfig:
    """Global alignment of all views; the paper has none."""

    mode: AlignmentMode = renamed(
        "loop_closure", "when", {"never": "off", "closed": "loop_closure"}
    )
    """Pose-graph optimisation of all views: off, or on loop closure and at the end."""
    misfits: Misfits = "keep"
    """Views that contradict most others at the end: keep them with a warning, or drop them."""
    min_overlap: float = number(0.15)
    """Share of the smaller view that must overlap for two views to be registered; less than
    planning.eta_min, so that no neighbours are left out."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "alignment")


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """Driving from one viewpoint to the next."""

    speed: float = number(0.25, most=0.5)
    """Driving speed [m/s]; half the 0.5 m/s of the base, so that bumps are gentle."""
    turn_rate: float = number(math.radians(90.0), most=5.0)
    """Turn rate on the spot [rad/s]: the wheels are then no faster than on the way, 0.2 m/s."""
    acceleration: float = number(0.5, most=10.0)
    """Acceleration of the wheels when starting and stopping [m/s2]; the base is capable of 1.8."""
    robot_radius: float = number(0.17)
    """Radius of the round body [m]; 0.165 for Create 1 and 2."""
    robot_height: float = number(0.35, most=3.0)
    """Height of the robot with its lidar [m]; it drives under things that begin higher."""
    clearance: float = number(0.05, 0.0, 2.0)
    """Clearance between the body and obstacles [m]; with robot_radius the costmap's inflation."""
    position_tolerance: float = number(0.01)
    """Distance within which a waypoint is reached [m]."""
    yaw_tolerance: float = number(math.radians(0.5), most=math.pi)
    """Angle within which a heading is reached [rad]."""
    bump_retries: int = number(3, 0, 1000)
    """Number of bumps on the way to a viewpoint after which another path is tried; 0: the first
    bump ends the run."""

    @property
    def self_radius(self) -> float:
        """Distance from the axis below which readings are the robot itself [m]."""
        return self.robot_radius + 0.03

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "motion")


@dataclass(frozen=True, slots=True)
class Config:
    """The configuration of a run; the effective one is saved with it.

    >>> config = s3d.Config(max_views=3, tour="full")
    >>> s3d.Config.preset("paper").registration.engine
    'icp'
    >>> s3d.Config(tour="back")
    Traceback (most recent call last):
    scan3d_twin.core.errors.ConfigError: tour must be one of front, full; got 'back'
    """

    tour: Tour = "front"
    """Part of the target that is scanned: its front, or all round (full)."""
    planner: str = "fisher"
    """Name of the planner, or module:attribute of one of your own."""
    max_views: int = number(20, 1, 1000)
    """Number of views after which the run stops."""
    optimize_for: Resource = renamed("speed", "spare", {"time": "speed"})
    """Optimise for speed or for memory: intermediate results are cached or computed again; the
    outcome is the same."""
    sweep: SweepConfig = field(default_factory=SweepConfig)
    mount: MountConfig = field(default_factory=MountConfig)
    gaps: GapConfig = field(default_factory=GapConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    planning: PlanningConfig = field(default_factory=PlanningConfig)
    baselines: BaselineConfig = field(default_factory=BaselineConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self)
        if self.planning.virtual_scan == "visible" and self.registration.engine != "grid":
            raise ConfigError(
                "planning.virtual_scan = visible simulates registration.engine = grid; choose that "
                "too"
            )

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Config:
        """Return the configuration of the preset ``name`` with ``changes``.

        Args:
            name: ``best``, which is ``Config()``, or ``paper``.
            **changes: Fields of ``Config`` that differ from the preset's; those of a section as a
                mapping.

        Raises:
            UnknownNameError: There is no such preset; the message lists them.
            ConfigError: A value is wrong.

        >>> s3d.Config.preset("best") == s3d.Config()
        True
        >>> s3d.Config.preset("paper", max_views=2).planner
        'siicp'
        >>> s3d.Config.preset("best", max_views=2, planning={"epsilon": 0.005})
        Config(max_views=2, planning=PlanningConfig(epsilon=0.005))
        """
        config = cls()
        for stated in (preset_options(name), changes):
            values = {
                key: _replace_section(config, key, value) if isinstance(value, Mapping) else value
                for key, value in stated.items()
            }
            config = replace(config, **values)
        return config


def preset_options(name: str) -> Mapping[str, Any]:
    """Return the options of the preset ``name``, in the shape of a configuration file.

    Both presets state the same options, so that either replaces the other.

    Raises:
        UnknownNameError: There is no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    if name != DEFAULT_PRESET:
        return PAPER
    default = Config()
    return {
        key: {name: getattr(getattr(default, key), field_name(name)) for name in value}
        if isinstance(value, Mapping)
        else getattr(default, key)
        for key, value in PAPER.items()
    }


def _replace_section(config: Config, key: str, values: Mapping[str, Any]) -> Any:
    """Return the section ``key`` of ``config`` with other ``values``, by key or field.

    Raises:
        ConfigError: There is no such section or option.
    """
    section = getattr(config, key, None)
    if not is_dataclass(section) or isinstance(section, type):
        raise ConfigError(f"there is no section {key} of options")
    known = {option_key(f.name): f.name for f in fields(section)}
    for name in values:
        if option_key(name) not in known:
            raise UnknownNameError(f"option of {key}", name, known)
    return replace(section, **{known[option_key(name)]: each for name, each in values.items()})
