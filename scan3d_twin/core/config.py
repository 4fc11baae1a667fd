"""Every knob of a run: nested frozen dataclasses in SI units, defaults with their source.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
The docstring below a field is its help text; invalid values are refused, never repaired.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from typing import Any, Literal

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.options import check_options, number, renamed
from scan3d_twin.core.presets import DEFAULT_PRESET, PAPER, PRESETS

Tour = Literal["front", "full"]
Resource = Literal["speed", "memory"]
Scope = Literal["target", "sweep"]
Turning = Literal["odometry", "look"]
Border = Literal["drop", "keep"]
Engine = Literal["icp", "grid"]
Draws = Literal["common", "independent"]
VirtualScan = Literal["smoothed", "copy", "visible"]
Foresight = Literal["none", "holdout"]
Criterion = Literal["displacement", "eq3", "nn"]
Feature = Literal["normals", "variation"]
CornerModel = Literal["contour", "silhouette"]
Closing = Literal["none", "hidden"]
AlignmentMode = Literal["off", "loop_closure"]
Misfits = Literal["keep", "drop"]
Gain = Literal["oa", "rse", "af"]
FrontierRule = Literal["surmann", "gonzalez-banos"]


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Turning on the spot while the scan lines sweep out a 3D image (paper section 3)."""

    width: float = number(math.radians(90.0), most=math.tau)
    """Horizontal angle of a sweep, the paper's C [rad]; 60 deg in the paper. To 45 deg from its
    middle, lines of 0.5 deg are 17 mm apart on a flat front at the standoff of 1 m."""
    margin: float = number(math.radians(30.0), 0.0, math.pi)
    """Swept beyond the width on either side, for registration and the model alone [rad]."""
    yaw_rate: float = number(math.radians(5.0), most=2.0)
    """Speed of the turn [rad/s]; 5 deg/s at 10 Hz puts the lines 0.5 deg apart."""
    look_rate: float = number(math.radians(20.0), most=4.0)
    """Speed of a look around [rad/s]; 2 deg between lines are enough to find a target."""
    turning: Turning = "look"
    """How far the robot turns: as the odometry tells, or corrected by the first look around, a full
    turn whose ends must meet."""
    settle: float = number(0.3, 0.0, 60.0)
    """Rest before a sweep [s]: several periods of the mast (11 to 18 Hz), till it is still."""
    retries: int = number(5, 0, 1000)
    """How often missing lines are scanned again before the run gives up."""

    def __post_init__(self) -> None:
        check_options(self, "sweep")
        if self.width + 2 * self.margin > math.tau:
            raise ConfigError(
                f"sweep.width + 2 sweep.margin must be <= 2 pi rad, got {self.width:g} and "
                f"{self.margin:g}"
            )


@dataclass(frozen=True, slots=True)
class MountConfig:
    """Where the lidar really sits, as `twin calibrate lidar` finds it; all 0 is as designed."""

    lateral: float = number(0.0, -0.2, 0.2)
    """To the left of where it should be [m]."""
    roll: float = number(0.0, -0.5, 0.5)
    """Leans to its right by this, about the axis ahead [rad]."""
    pitch: float = number(0.0, -0.5, 0.5)
    """Looks down by this, about the axis to the left [rad]."""
    yaw_scale: float = number(0.0, -0.2, 0.2)
    """The robot turns by this share more than its odometry tells."""
    time_offset: float = number(0.0, -1.0, 1.0)
    """The readings are of this much later than their stamps tell [s]."""

    def __post_init__(self) -> None:
        check_options(self, "mount")


@dataclass(frozen=True, slots=True)
class GapConfig:
    """Gap filling (paper section 4.1)."""

    max_angle: float = number(math.radians(3.0), most=math.pi)
    """Widest gap that is filled, along a line or across lines [rad]."""
    depth_edge: float = number(0.04, most=10.0)
    """Readings that differ by more than this are of different surfaces [m]; 4 sigma at 4 m."""

    def __post_init__(self) -> None:
        check_options(self, "gaps")


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """Target extraction (paper section 4.2)."""

    window: float = number(math.radians(75.0), most=math.tau)
    """Vertical angle around the horizontal that is modelled [rad]; paper section 4.2: 75 deg."""
    max_range: float = number(4.0, most=100.0)
    """Readings beyond this are not used [m]; URG-04LX data sheet."""
    floor_height: float = number(0.03, 0.0, 1.0)
    """Points below this are floor [m]; 3 sigma of the range noise at 1 m."""
    cluster_gap: float = number(0.20, most=10.0)
    """Two things closer than this in the top view are one target [m]."""
    min_points: int = number(30, 1, 1_000_000)
    """Smaller groups of points are stray points."""

    def __post_init__(self) -> None:
        check_options(self, "target")


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Registration of two views (paper eq. 1)."""

    scope: Scope = "sweep"
    """Which points are registered: the target's alone as in the paper, or the whole sweep's."""
    max_correspondence_distance: float = number(0.10, most=10.0)
    """Pairs farther apart than this are no correspondence [m]."""
    engine: Engine = "grid"
    """How: the paper's point-to-point ICP, or surfels on the grid of lines and beams."""
    bias_sigma: float = number(0.003, 0.0, 0.1)
    """Range error that neighbouring readings share, for the grid engine [m]; within the +-10 mm of
    the URG-04LX's data sheet, and more than its noise in the mean of a surface."""
    starts: int = number(16, 1, 1000)
    """Starts of the grid engine, spread over the odometry's error."""
    yaw_scale_sigma: float = number(0.01, 0.0, 0.2)
    """Relative error of all yaws for the grid engine: the wheel base is known to 1 %."""
    border: Border = "drop"
    """Pairs on the border of the target scan, where the surface goes on unseen: drop or keep."""
    max_iterations: int = number(100, 1, 100_000)
    """Iterations after which ICP stops."""
    translation_epsilon: float = number(5e-5)
    """Converged when a step is shorter than this [m] ..."""
    rotation_epsilon: float = number(5e-5)
    """... and turns less than this [rad]."""
    max_points: int = number(3000, 1, 10_000_000)
    """Source points used per registration; more are thinned out evenly."""
    min_fitness: float = number(0.3)
    """A smaller share of source points with a correspondence is no registration."""

    def __post_init__(self) -> None:
        check_options(self, "registration")


@dataclass(frozen=True, slots=True)
class AlignmentConfig:
    """Global alignment of all views; the paper has none."""

    mode: AlignmentMode = renamed(
        "loop_closure", "when", {"never": "off", "closed": "loop_closure"}
    )
    """Pose-graph optimization of all views: off, or on loop closure and at the end."""
    misfits: Misfits = "keep"
    """Views that contradict most others at the end: keep them, with a warning, or drop them."""
    min_overlap: float = number(0.15)
    """Two views are registered when so much of the smaller one finds a partner; less than
    planning.eta_min, so that no neighbours are left out."""

    def __post_init__(self) -> None:
        check_options(self, "alignment")


@dataclass(frozen=True, slots=True)
class PlanningConfig:
    """Viewpoint planning (paper section 5)."""

    epsilon: float = number(0.010, most=10.0)
    """Predefined accuracy: wanted registration error, root mean square [m]; paper section 6."""
    eta_min: float = number(0.2)
    """Smallest overlap tried; paper, pseudo-code step 1."""
    eta_max: float = number(0.8)
    """Largest overlap tried; paper, pseudo-code step 1."""
    eta_step: float = number(0.1)
    """Step between the overlaps tried."""
    default_overlap: float = number(0.8)
    """Overlap taken when none meets epsilon; paper section 5."""
    alpha: float = number(0.9)
    """Share of Q that the virtual scan holds, eq. (5)."""
    lambda_: float = number(0.005, 0.0, 10.0)
    """Translation error per metre of the move, eq. (2); 0.003 for 30 robots by
    benchmarks/motion_error.py, rounded up, as a run's own innovations scale it. Plain odometry:
    0.030."""
    gamma: float = number(0.013, 0.0, 10.0)
    """Rotation error per radian of the turn, eq. (2) [rad/rad]; fitted there too: 0.011."""
    drift: float = number(0.030, 0.0, 10.0)
    """Heading error per metre driven, not in the paper [rad/m]; fitted there too: 0.029."""
    sigma: float = number(0.005, 0.0, 1.0)
    """N_noise of eq. (2) in x, y and z [m]; URG-04LX: 4 to 5 mm up to 2 m."""
    virtual_scan: VirtualScan = "smoothed"
    """What Q'' is made from: the surface behind the noise of P, P's very readings, or what would be
    visible from O2, read anew and registered by the grid engine."""
    criterion: Criterion = "displacement"
    """Error E: eq. (3) on noise-free points, as printed, or the nearest-neighbour residual."""
    calibration: float = number(2.67, most=100.0)
    """Factor on the closed-form prediction: the conformal factor by benchmarks/calibrate_error.py
    on random:1000 to random:1024 (68 steps: 2.67; from the odd seeds alone 3.18, which none of the
    even ones' 35 steps exceeds)."""
    trials: int = number(1, 1, 100_000)
    """Random draws per overlap; the paper draws once."""
    draws: Draws = "common"
    """Whether all overlaps are tried with the same luck, or each with its own."""
    quantile: float = number(0.8)
    """Share of the draws that must meet epsilon."""
    certainty: float = number(0.95)
    """Of the outcome at which ``visible`` draws end early; 1 only where it is settled."""
    checks: int = number(6, 0, 1000)
    """Simulated registrations that the closed form's choice must stand, 0 for none."""
    standoff: float = number(1.0, most=100.0)
    """Distance from the surface at which a viewpoint is wanted [m]."""
    foresight: Foresight = "none"
    """Whether the surface beyond the scan's edge is predicted to place the next view: not, or by
    the predictor that wins a hold-out on the scan itself."""
    foresight_sigma: float = number(0.03, most=10.0)
    """A prediction with a larger hold-out error is not used [m]; a few per cent of the standoff."""
    corner_model: CornerModel = renamed("silhouette", "bend")
    """How the surface goes on where the target ends in view: as curved as its contour, or, since
    that end is a silhouette, by a right angle."""
    closing: Closing = "hidden"
    """Whether views are added when the contour is done: none, or where niches and gaps hide
    more."""
    least_hidden: float = number(0.010, most=100.0)
    """Hidden surface that a view must be expected to show to be added, as it sees it, foreshortened
    [m2]; 10 by 10 cm."""

    def __post_init__(self) -> None:
        check_options(self, "planning")
        if not self.eta_min <= self.eta_max < 1.0:
            raise ConfigError(
                "planning.eta_min must be <= planning.eta_max, and both < 1, got "
                f"{self.eta_min:g} and {self.eta_max:g}"
            )


@dataclass(frozen=True, slots=True)
class BaselineConfig:
    """Planners other than the paper's; their sources are in docs/planners.md."""

    fixed_overlap: float = number(0.5)
    """Overlap of `fixed`."""
    resampled_area: float = number(0.3, 0.0, 1.0)
    """`pito`: share of the current area that must be sampled again, weighted by the incidence."""
    feature: Feature = "normals"
    """`curvature`: what is a feature, spread of the normals or surface variation."""
    feature_score: float = number(0.05, 0.0, 1.0)
    """`curvature`: share of the current area that must be features seen again; an assumption."""
    gain: Gain = "rse"
    """`ig`: gain of a ray: occlusion aware (oa), rear side entropy (rse), area factor (af)."""
    frontier: FrontierRule = "surmann"
    """`frontier2d`: value of a viewpoint by Surmann and Nuechter, or by Gonzalez-Banos."""
    min_solid_edge: float = number(0.5, 0.0, 100.0)
    """`frontier2d` by Gonzalez-Banos: length of known edge that must be seen again [m]."""
    travel_weight: float = number(0.1, 0.0, 1000.0)
    """`ig`: weight of a viewpoint's share of all travel against its share of all gain."""
    min_new_area: float = number(0.03, 0.0, 10_000.0)
    """Unseen area at the target's border below which there is nothing more to see [m2]."""
    grid_step: float = number(0.25, 0.05, 1.0)
    """Distance of the places that are candidates [m]."""
    min_overlap: float = number(0.2, 0.0, 1.0)
    """`oracle`: least overlap of consecutive views."""
    coverage: float = number(0.95)
    """`oracle`: share of the coverable surface that its views see."""

    def __post_init__(self) -> None:
        check_options(self, "baselines")


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """Driving from one viewpoint to the next."""

    speed: float = number(0.2, most=0.5)
    """Speed ahead [m/s]; well under the 0.5 m/s of the base, so that bumps are gentle."""
    turn_rate: float = number(math.radians(45.0), most=5.0)
    """Speed of a turn on the spot [rad/s]."""
    acceleration: float = number(0.5, most=10.0)
    """Of the wheels when starting and stopping [m/s2]; the base itself can do 1.8."""
    robot_radius: float = number(0.17)
    """Radius of the round body [m]; 0.165 for Create 1 and 2."""
    robot_height: float = number(0.35, most=3.0)
    """Height of the robot with its lidar [m]; things that begin higher are driven under."""
    clearance: float = number(0.05, 0.0, 2.0)
    """Room kept between the body and anything else [m]."""
    position_tolerance: float = number(0.01)
    """A waypoint is reached within this distance [m]."""
    yaw_tolerance: float = number(math.radians(0.5), most=math.pi)
    """A heading is reached within this angle [rad]."""
    bump_retries: int = number(3, 0, 1000)
    """Bumps on the way to a viewpoint after which another way is tried; 0: the first one ends the
    run."""

    @property
    def self_radius(self) -> float:
        """Readings nearer to the axis than this are the robot itself [m]."""
        return self.robot_radius + 0.03

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
    """Scan the front only, or all round."""
    planner: str = "fisher"
    """Name of the planner, or module:attribute of one of your own."""
    max_views: int = number(20, 1, 1000)
    """The run stops after this many views."""
    optimize_for: Resource = renamed("speed", "spare", {"time": "speed"})
    """Optimise for speed or for memory: what a run computed and may need again is kept, or
    computed anew; the results are the same."""
    sweep: SweepConfig = field(default_factory=SweepConfig)
    mount: MountConfig = field(default_factory=MountConfig)
    gaps: GapConfig = field(default_factory=GapConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    planning: PlanningConfig = field(default_factory=PlanningConfig)
    baselines: BaselineConfig = field(default_factory=BaselineConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)

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
            **changes: Fields of ``Config`` that differ from the preset's.

        Raises:
            UnknownNameError: There is no such preset; the message lists them.
            ConfigError: A value is wrong.

        >>> s3d.Config.preset("best") == s3d.Config()
        True
        >>> s3d.Config.preset("paper", max_views=2).planner
        'siicp'
        """
        config = cls()
        stated = {
            key: replace(getattr(config, key), **_by_field(value))
            if isinstance(value, Mapping)
            else value
            for key, value in preset_options(name).items()
        }
        return replace(config, **{**stated, **changes})


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
        key: {k: getattr(getattr(default, key), field_name) for k, field_name in _fields(value)}
        if isinstance(value, Mapping)
        else getattr(default, key)
        for key, value in PAPER.items()
    }


def _fields(section: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return each key of a ``section`` with its field: ``lambda_`` for ``lambda``."""
    return [(key, f"{key}_" if iskeyword(key) else key) for key in section]


def _by_field(section: Mapping[str, Any]) -> dict[str, Any]:
    return {field_name: section[key] for key, field_name in _fields(section)}
