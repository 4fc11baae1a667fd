"""Every knob of a run: nested frozen dataclasses in SI units, defaults with their source.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
The docstring below a field is its help text; invalid values are refused, never repaired.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from scan3d_twin.core.errors import ConfigError

Tour = Literal["front", "full"]
Spare = Literal["time", "memory"]
Scope = Literal["target", "sweep"]
Turning = Literal["odometry", "look"]
Border = Literal["drop", "keep"]
Engine = Literal["icp", "grid"]
Draws = Literal["common", "independent"]
VirtualScan = Literal["smoothed", "copy", "visible"]
Foresight = Literal["none", "holdout"]
Criterion = Literal["displacement", "eq3", "nn"]
Feature = Literal["normals", "variation"]
Bend = Literal["contour", "silhouette"]
Closing = Literal["none", "hidden"]
When = Literal["never", "closed"]
Misfits = Literal["keep", "drop"]
Gain = Literal["oa", "rse", "af"]
FrontierRule = Literal["surmann", "gonzalez-banos"]


def _check(condition: bool, message: str) -> None:
    if not condition:
        raise ConfigError(message)


def _positive(section: str, **values: float) -> None:
    for name, value in values.items():
        _check(value > 0 and math.isfinite(value), f"{section}.{name} must be > 0, got {value:g}")


def _share(section: str, **values: float) -> None:
    for name, value in values.items():
        _check(0.0 < value <= 1.0, f"{section}.{name} must be in (0, 1], got {value:g}")


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Turning on the spot while the scan lines sweep out a 3D image (paper section 3)."""

    width: float = math.radians(60.0)
    """Horizontal angle of a sweep, the paper's C [rad]; 60 deg see 1.15 m at the 1 m standoff."""
    margin: float = 0.0
    """Swept beyond the width on either side, for registration and the model alone [rad]."""
    yaw_rate: float = math.radians(5.0)
    """Speed of the turn [rad/s]; 5 deg/s at 10 Hz puts the lines 0.5 deg apart."""
    look_rate: float = math.radians(20.0)
    """Speed of a look around [rad/s]; 2 deg between lines are enough to find a target."""
    turning: Turning = "odometry"
    """How far the robot turns: as the odometry tells, or corrected by the first look around, a full
    turn whose ends must meet."""
    settle: float = 0.3
    """Rest before a sweep [s]: several periods of the mast (11 to 18 Hz), till it is still."""
    retries: int = 5
    """How often missing lines are scanned again before the run gives up."""

    def __post_init__(self) -> None:
        _positive("sweep", width=self.width, yaw_rate=self.yaw_rate, look_rate=self.look_rate)
        _check(self.width <= math.tau, f"sweep.width must be <= 2 pi rad, got {self.width:g}")
        _check(
            0.0 <= self.margin <= (math.tau - self.width) / 2,
            f"sweep.margin must be >= 0 and sweep.width + 2 margin <= 2 pi, got {self.margin:g}",
        )
        _check(self.settle >= 0, f"sweep.settle must be >= 0 s, got {self.settle:g}")
        _check(self.retries >= 0, f"sweep.retries must be >= 0, got {self.retries}")


@dataclass(frozen=True, slots=True)
class MountConfig:
    """Where the lidar really sits, as `twin calibrate lidar` finds it; all 0 is as designed."""

    lateral: float = 0.0
    """To the left of where it should be [m]."""
    roll: float = 0.0
    """Leans to its right by this, about the axis ahead [rad]."""
    pitch: float = 0.0
    """Looks down by this, about the axis to the left [rad]."""
    yaw_scale: float = 0.0
    """The robot turns by this share more than its odometry tells."""
    time_offset: float = 0.0
    """The readings are of this much later than their stamps tell [s]."""

    def __post_init__(self) -> None:
        limits = {"lateral": 0.2, "roll": 0.5, "pitch": 0.5, "yaw_scale": 0.2, "time_offset": 1.0}
        for name, most in limits.items():
            value = getattr(self, name)
            _check(abs(value) <= most, f"mount.{name} must be within +-{most:g}, got {value:g}")


@dataclass(frozen=True, slots=True)
class GapConfig:
    """Gap filling (paper section 4.1)."""

    max_angle: float = math.radians(3.0)
    """Widest gap that is filled, along a line or across lines [rad]."""
    depth_edge: float = 0.04
    """Readings that differ by more than this are of different surfaces [m]; 4 sigma at 4 m."""

    def __post_init__(self) -> None:
        _positive("gaps", max_angle=self.max_angle, depth_edge=self.depth_edge)


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """Target extraction (paper section 4.2)."""

    window: float = math.radians(75.0)
    """Vertical angle around the horizontal that is modelled [rad]; paper section 4.2: 75 deg."""
    max_range: float = 4.0
    """Readings beyond this are not used [m]; URG-04LX data sheet."""
    floor_height: float = 0.03
    """Points below this are floor [m]; 3 sigma of the range noise at 1 m."""
    cluster_gap: float = 0.20
    """Two things closer than this in the top view are one target [m]."""
    min_points: int = 30
    """Smaller groups of points are stray points."""

    def __post_init__(self) -> None:
        _positive(
            "target", window=self.window, max_range=self.max_range, cluster_gap=self.cluster_gap
        )
        _check(self.min_points >= 1, f"target.min_points must be >= 1, got {self.min_points}")


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Registration of two views (paper eq. 1)."""

    scope: Scope = "target"
    """Which points are registered: the target's alone as in the paper, or the whole sweep's."""
    max_correspondence_distance: float = 0.10
    """Pairs farther apart than this are no correspondence [m]."""
    engine: Engine = "icp"
    """How: the paper's point-to-point ICP, or surfels on the grid of lines and beams."""
    bias_sigma: float = 0.003
    """Range error that neighbouring readings share, for the grid engine [m]; within the +-10 mm of
    the URG-04LX's data sheet, and more than its noise in the mean of a surface."""
    starts: int = 16
    """Starts of the grid engine, spread over the odometry's error."""
    yaw_scale_sigma: float = 0.01
    """Relative error of all yaws for the grid engine: the wheel base is known to 1 %."""
    border: Border = "drop"
    """Pairs on the border of the target scan, where the surface goes on unseen: drop or keep."""
    max_iterations: int = 100
    """Iterations after which ICP stops."""
    translation_epsilon: float = 5e-5
    """Converged when a step is shorter than this [m] ..."""
    rotation_epsilon: float = 5e-5
    """... and turns less than this [rad]."""
    max_points: int = 3000
    """Source points used per registration; more are thinned out evenly."""
    min_fitness: float = 0.3
    """A smaller share of source points with a correspondence is no registration."""

    def __post_init__(self) -> None:
        _positive(
            "registration",
            max_correspondence_distance=self.max_correspondence_distance,
            max_iterations=self.max_iterations,
            translation_epsilon=self.translation_epsilon,
            rotation_epsilon=self.rotation_epsilon,
            max_points=self.max_points,
            starts=self.starts,
        )
        _check(
            0.0 <= self.bias_sigma <= 0.1,
            f"registration.bias_sigma must be in [0, 0.1] m, got {self.bias_sigma:g}",
        )
        _check(
            0.0 <= self.yaw_scale_sigma <= 0.2,
            f"registration.yaw_scale_sigma must be in [0, 0.2], got {self.yaw_scale_sigma:g}",
        )
        _share("registration", min_fitness=self.min_fitness)


@dataclass(frozen=True, slots=True)
class AlignmentConfig:
    """Global alignment of all views; the paper has none."""

    when: When = "never"
    """Whether all views are placed at once when the contour closes and at the end, or never."""
    misfits: Misfits = "keep"
    """Views that contradict most others at the end: keep them, with a warning, or drop them."""
    min_overlap: float = 0.15
    """Two views are registered when so much of the smaller one finds a partner; less than
    planning.eta_min, so that no neighbours are left out."""

    def __post_init__(self) -> None:
        _share("alignment", min_overlap=self.min_overlap)


@dataclass(frozen=True, slots=True)
class PlanningConfig:
    """Viewpoint planning (paper section 5)."""

    epsilon: float = 0.010
    """Predefined accuracy: wanted registration error, root mean square [m]; paper section 6."""
    eta_min: float = 0.2
    """Smallest overlap tried; paper, pseudo-code step 1."""
    eta_max: float = 0.8
    """Largest overlap tried; paper, pseudo-code step 1."""
    eta_step: float = 0.1
    """Step between the overlaps tried."""
    default_overlap: float = 0.8
    """Overlap taken when none meets epsilon; paper section 5."""
    alpha: float = 0.9
    """Share of Q that the virtual scan holds, eq. (5)."""
    lambda_: float = 0.030
    """Translation error per metre of the move, eq. (2); fitted by benchmarks/motion_error.py."""
    gamma: float = 0.026
    """Rotation error per radian of the turn, eq. (2) [rad/rad]; fitted there too."""
    drift: float = 0.036
    """Heading error per metre driven, not in the paper [rad/m]; 2.07 deg/m of the odometry."""
    sigma: float = 0.005
    """N_noise of eq. (2) in x, y and z [m]; URG-04LX: 4 to 5 mm up to 2 m."""
    virtual_scan: VirtualScan = "smoothed"
    """What Q'' is made from: the surface behind the noise of P, P's very readings, or what would be
    visible from O2, read anew and registered by the grid engine."""
    criterion: Criterion = "displacement"
    """Error E: eq. (3) on noise-free points, as printed, or the nearest-neighbour residual."""
    calibration: float = 1.0
    """Factor on the closed-form prediction, so that few errors exceed epsilon; see presets."""
    trials: int = 1
    """Random draws per overlap; the paper draws once."""
    draws: Draws = "common"
    """Whether all overlaps are tried with the same luck, or each with its own."""
    quantile: float = 0.9
    """Share of the draws that must meet epsilon."""
    certainty: float = 0.95
    """Of the outcome at which ``visible`` draws end early; 1 only where it is settled."""
    checks: int = 0
    """Simulated registrations that the closed form's choice must stand, 0 for none."""
    standoff: float = 1.0
    """Distance from the surface at which a viewpoint is wanted [m]."""
    foresight: Foresight = "none"
    """Whether the surface beyond the scan's edge is predicted to place the next view: not, or by
    the predictor that wins a hold-out on the scan itself."""
    foresight_sigma: float = 0.03
    """A prediction with a larger hold-out error is not used [m]; a few per cent of the standoff."""
    bend: Bend = "contour"
    """How the surface goes on where the target ends in view: as curved as its contour, or, since
    that end is a silhouette, by a right angle."""
    closing: Closing = "none"
    """Whether views are added when the contour is done: none, or where niches and gaps hide
    more."""
    least_hidden: float = 0.010
    """Hidden surface that a view must be expected to show to be added, as it sees it, foreshortened
    [m2]; 10 by 10 cm."""

    def __post_init__(self) -> None:
        _positive("planning", calibration=self.calibration, least_hidden=self.least_hidden)
        _positive("planning", epsilon=self.epsilon, eta_step=self.eta_step, standoff=self.standoff)
        _share(
            "planning",
            alpha=self.alpha,
            quantile=self.quantile,
            certainty=self.certainty,
            default_overlap=self.default_overlap,
        )
        _check(
            0.0 < self.eta_min <= self.eta_max < 1.0,
            f"planning.eta_min..eta_max must lie in 0..1, got {self.eta_min:g}..{self.eta_max:g}",
        )
        for name in ("lambda_", "gamma", "drift", "sigma"):
            _check(getattr(self, name) >= 0, f"planning.{name.rstrip('_')} must be >= 0")
        _check(self.trials >= 1, f"planning.trials must be >= 1, got {self.trials}")
        _check(self.checks >= 0, f"planning.checks must be >= 0, got {self.checks}")


@dataclass(frozen=True, slots=True)
class BaselineConfig:
    """Planners other than the paper's; their sources are in docs/planners.md."""

    fixed_overlap: float = 0.5
    """Overlap of `fixed`."""
    resampled_area: float = 0.3
    """`pito`: share of the current area that must be sampled again, weighted by the incidence."""
    feature: Feature = "normals"
    """`curvature`: what is a feature, spread of the normals or surface variation."""
    feature_score: float = 0.05
    """`curvature`: share of the current area that must be features seen again; an assumption."""
    gain: Gain = "rse"
    """`ig`: gain of a ray: occlusion aware (oa), rear side entropy (rse), area factor (af)."""
    frontier: FrontierRule = "surmann"
    """`frontier2d`: value of a viewpoint by Surmann and Nuechter, or by Gonzalez-Banos."""
    min_solid_edge: float = 0.5
    """`frontier2d` by Gonzalez-Banos: length of known edge that must be seen again [m]."""
    travel_weight: float = 0.1
    """`ig`: weight of a viewpoint's share of all travel against its share of all gain."""
    min_new_area: float = 0.03
    """Unseen area at the target's border below which there is nothing more to see [m2]."""
    grid_step: float = 0.25
    """Distance of the places that are candidates [m]."""
    min_overlap: float = 0.2
    """`oracle`: least overlap of consecutive views."""
    coverage: float = 0.95
    """`oracle`: share of the coverable surface that its views see."""

    def __post_init__(self) -> None:
        _share(
            "baselines",
            fixed_overlap=self.fixed_overlap,
            coverage=self.coverage,
        )
        for name in ("resampled_area", "feature_score", "min_overlap"):
            value = getattr(self, name)
            _check(0.0 <= value <= 1.0, f"baselines.{name} must be in [0, 1], got {value:g}")
        for name in ("min_solid_edge", "travel_weight", "min_new_area"):
            _check(getattr(self, name) >= 0, f"baselines.{name} must be >= 0")
        _check(
            0.05 <= self.grid_step <= 1.0,
            f"baselines.grid_step must be in [0.05, 1] m, got {self.grid_step:g}",
        )


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """Driving from one viewpoint to the next."""

    speed: float = 0.2
    """Speed ahead [m/s]; well under the 0.5 m/s of the base, so that bumps are gentle."""
    turn_rate: float = math.radians(45.0)
    """Speed of a turn on the spot [rad/s]."""
    acceleration: float = 0.5
    """Of the wheels when starting and stopping [m/s2]; the base itself can do 1.8."""
    robot_radius: float = 0.17
    """Radius of the round body [m]; 0.165 for Create 1 and 2."""
    robot_height: float = 0.35
    """Height of the robot with its lidar [m]; things that begin higher are driven under."""
    clearance: float = 0.05
    """Room kept between the body and anything else [m]."""
    position_tolerance: float = 0.01
    """A waypoint is reached within this distance [m]."""
    yaw_tolerance: float = math.radians(0.5)
    """A heading is reached within this angle [rad]."""
    bump_retries: int = 3
    """Bumps on the way to a viewpoint after which another way is tried; 0: the first one ends the
    run."""

    @property
    def self_radius(self) -> float:
        """Readings nearer to the axis than this are the robot itself [m]."""
        return self.robot_radius + 0.03

    def __post_init__(self) -> None:
        _positive(
            "motion",
            robot_radius=self.robot_radius,
            robot_height=self.robot_height,
            speed=self.speed,
            turn_rate=self.turn_rate,
            acceleration=self.acceleration,
            position_tolerance=self.position_tolerance,
            yaw_tolerance=self.yaw_tolerance,
        )
        _check(self.bump_retries >= 0, f"motion.bump_retries must be >= 0, got {self.bump_retries}")
        _check(self.clearance >= 0, f"motion.clearance must be >= 0 m, got {self.clearance:g}")


@dataclass(frozen=True, slots=True)
class Config:
    """The configuration of a run; the effective one is saved with it."""

    tour: Tour = "front"
    """Scan the front only, or all round."""
    planner: str = "siicp"
    """Name of the planner."""
    max_views: int = 20
    """The run stops after this many views."""
    spare: Spare = "time"
    """What there is least of, time or memory: what a run computed and may need again is kept, or
    made anew; the results are the same."""
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
        _check(self.tour in ("front", "full"), f"tour must be front or full, got {self.tour!r}")
        _check(
            self.spare in ("time", "memory"), f"spare must be time or memory, got {self.spare!r}"
        )
        _check(self.max_views >= 1, f"max_views must be >= 1, got {self.max_views}")
        _check(
            self.planning.virtual_scan != "visible" or self.registration.engine == "grid",
            "planning.virtual_scan = visible simulates registration.engine = grid; choose that too",
        )
