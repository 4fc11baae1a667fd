"""The options of planning: those of the paper's planner and its successors, and of the baselines.

As in ``config.py``, the docstring below a field is its help text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.options import check_options, number, renamed, repr_options

Draws = Literal["common", "independent"]
VirtualScan = Literal["smoothed", "copy", "visible"]
Foresight = Literal["none", "holdout"]
Criterion = Literal["displacement", "eq3", "nn"]
Feature = Literal["normals", "variation"]
CornerModel = Literal["contour", "silhouette"]
Closing = Literal["none", "hidden"]
StandoffRule = Literal["fixed", "height"]
Sector = Literal["whole", "target"]
Fallback = Literal["default", "best"]
Gain = Literal["oa", "rse", "af"]
FrontierRule = Literal["surmann", "gonzalez-banos"]


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
    """Overlap taken when none meets epsilon, by `fallback` or as no error can be predicted;
    paper section 5."""
    fallback: Fallback = "best"
    """Viewpoint taken when no overlap meets epsilon: at default_overlap, or, oblique ones included,
    the one with the least expected error (best)."""
    alpha: float = number(0.9)
    """Share of the lines of Q that make the virtual scan, eq. (5)."""
    lambda_: float = number(0.005, 0.0, 10.0)
    """Translation error per metre of the move, eq. (2); 0.003 for 30 robots by
    benchmarks/motion_error.py, rounded up, as the innovations of a run scale it. Plain odometry:
    0.030."""
    gamma: float = number(0.013, 0.0, 10.0)
    """Rotation error per radian of the turn, eq. (2) [rad/rad]; fitted there too: 0.011."""
    drift: float = number(0.030, 0.0, 10.0)
    """Heading error per metre driven, not in the paper [rad/m]; fitted there too: 0.029."""
    motion_variation: float = number(0.03, 0.0, 1.0)
    """Share of lambda, gamma and drift that changes from move to move; the rest is the robot's own
    and is learned in the run. On random:20200 to random:20239 the third and later moves are off by
    1.7 mrad, where 2.9 mrad are assumed, and 4.0 with 0.05. 1: nothing is learned."""
    sigma: float = number(0.005, 0.0, 1.0)
    """Standard deviation of N_noise of eq. (2) in x, y and z [m]; URG-04LX: 4 to 5 mm up to 2 m."""
    virtual_scan: VirtualScan = "smoothed"
    """Source of the virtual scan Q'': the smoothed surface of P, a copy of its readings, or what
    would be visible from O2, scanned anew and registered by the grid engine."""
    criterion: Criterion = "displacement"
    """Error measure E: eq. (3) on noise-free points (displacement) or as printed (eq3), or the
    nearest-neighbour residual (nn)."""
    calibration: float = number(2.25, most=100.0)
    """Factor on the predicted error in closed form, which the error of the next step exceeds with a
    probability of at most 2.5 %, as a run is kept only if each of its steps is;
    benchmarks/calibrate_error.py --factor 2.0 on random:2000 to random:2119 (437 steps)."""
    trials: int = number(1, 1, 100_000)
    """Number of simulated registrations per overlap; the paper has one."""
    draws: Draws = "common"
    """Motion errors of the simulations: the same for all overlaps, or drawn anew for each."""
    quantile: float = number(0.8)
    """Share of the simulated registrations that must meet epsilon."""
    certainty: float = number(0.95)
    """Confidence at which sampling of `visible` simulations stops early; 1 disables early stopping
    before the outcome is certain."""
    checks: int = number(6, 0, 1000)
    """Number of simulated registrations that check the choice of `fisher`; 0 for none."""
    standoff: float = number(1.0, most=100.0)
    """Wanted distance of a viewpoint from the surface [m]."""
    standoff_rule: StandoffRule = "height"
    """Standoff: as configured (fixed), or changed where the height of the target in the first
    panorama asks for it, so that its top is in view."""
    sector: Sector = "target"
    """Sector of a sweep: the whole of sweep.width and margins, or as much as shows the target, if
    the predicted error then meets epsilon."""
    foresight: Foresight = "none"
    """Prediction of the surface beyond the scan's edge, to place the next view: none, or by the
    predictor that is best on a part of the scan held out from it."""
    foresight_sigma: float = number(0.03, most=10.0)
    """Largest hold-out error of a prediction that is used [m]; a few per cent of the standoff."""
    corner_model: CornerModel = renamed("silhouette", "bend")
    """Shape of the surface beyond an end of the target that is in view: as curved as its contour,
    or, as that end is a silhouette, at a right angle."""
    closing: Closing = "hidden"
    """Views that are added when the contour is complete: none, or of surface hidden in niches and
    gaps."""
    least_hidden: float = number(0.010, most=100.0)
    """Smallest area of hidden surface, foreshortened, for which a view is added [m2]; 10 by 10
    cm."""

    __repr__ = repr_options

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
    """`pito`: share of the current area that must be sampled again, weighted by incidence."""
    feature: Feature = "normals"
    """`curvature`: kind of feature, spread of the normals or surface variation."""
    feature_score: float = number(0.05, 0.0, 1.0)
    """`curvature`: share of the current area that must be features in the overlap; an
    assumption."""
    gain: Gain = "rse"
    """`ig`: gain of a ray: occlusion aware (oa), rear side entropy (rse), area factor (af)."""
    frontier: FrontierRule = "surmann"
    """`frontier2d`: value of a viewpoint by Surmann and Nuechter, or by Gonzalez-Banos."""
    min_solid_edge: float = number(0.5, 0.0, 100.0)
    """`frontier2d` by Gonzalez-Banos: length of known edge that must be seen again [m]."""
    travel_weight: float = number(0.1, 0.0, 1000.0)
    """`ig`: weight of a viewpoint's share of the total travel against its share of the gain."""
    min_new_area: float = number(0.03, 0.0, 10_000.0)
    """Unseen area at the target's border below which the scan is complete [m2]."""
    grid_step: float = number(0.25, 0.05, 1.0)
    """Spacing of the grid of candidate places [m]."""
    min_overlap: float = number(0.2, 0.0, 1.0)
    """`oracle`: smallest overlap of consecutive views."""
    coverage: float = number(0.95)
    """`oracle`: share of the coverable surface that its views see."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "baselines")
