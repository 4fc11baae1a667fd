"""Extrinsic calibration of the lidar from scans alone: the right extrinsics keep planes flat.

Let the lidar be off to the side by y, lean by roll and look down by pitch, and let the heading have
a relative error k and a delay tau. The reading r of beam d, taken at heading psi and turn rate w,
is then at

    P = Rz((1 + k) psi + w tau) (t + y e_y + (r + b) R Ry(pitch) Rx(roll) d).

A turntable measures its angle, k = 0, but what it carries lags behind by half of the play p that
its driver does not know of, and a lidar that looks along the axis may be turned out of it by yaw:

    P = Rz(psi + w tau - sign(w) p / 2) (t + y e_y + (r + b) R Rz(yaw) Ry(pitch) d).

Wrong values bend a wall: y rotates it about the axis by y / rho, that is more where it is nearer;
roll rotates it in proportion to the height; pitch makes a cone of the floor; k separates the two
ends of a full turn. Calibration minimises the distances of all readings from their planes,

    min  sum_j sum_i w_i (n_j . P_i - d_j)^2   over  the parameters, b  and all (n_j, d_j),

by Gauss-Newton with the planes eliminated one by one (Schur complement). The range error b that all
readings share is a nuisance parameter, and so is a curve of range errors of each plane: what
depends on the range alone, as the cone of a floor, is not believed. A panorama before a run, which
only warns, goes without these curves.

Delay and play are observable only if sweeps in both directions were taken from one place, as these
share their planes, and apart from each other only at two rates: a delay shifts a sweep in
proportion to its rate, play by a constant. A turn of the lidar about the axis itself is that of the
zero of the angle, which planes do not show; what the axis, with that zero, leans against the floor
is found from the normal of the floor. Standard errors are by the jackknife, leaving out one plane
after the other, as the readings of a surface err together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.config import Config, MountConfig
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.scanning.calibration.extrinsics import compose_mounts, describe_mount
from scan3d_twin.core.scanning.calibration.planes import STEEP, PlaneFit, find_planes, fit_plane
from scan3d_twin.core.scanning.calibration.samples import (
    Samples,
    estimate_yaw_scale,
    gather_samples,
)
from scan3d_twin.core.scanning.patterns import is_ahead, is_vertical
from scan3d_twin.core.session import YAW_SCALE_REPEATABILITY
from scan3d_twin.core.types import FloatArray, IntArray, RangeImage, read_only

PARAMETERS = (
    "lateral", "roll", "pitch", "yaw_scale", "time_offset", "yaw", "play", "axis_roll",
    "axis_pitch",
)  # fmt: skip
"""The estimated fields of ``MountConfig``."""
SOUGHT = ("lateral", "roll", "pitch", "yaw_scale", "time_offset", "range_error", "yaw", "play")
"""What keeps planes flat, in the order of parameter vectors."""
RANGE_ERROR = SOUGHT.index("range_error")
PRIOR_SIGMAS = np.array([0.05, 0.1, 0.1, 0.05, 0.2, 0.01, 0.1, 0.05])
"""Prior standard deviations of them: a mount aligned by eye, for the range error the lidar's data
sheet (+-10 mm), and for the play three times that of a servo."""
BASE_SOUGHT = SOUGHT[:6]
"""What is sought where the base turns."""
ALONG_AXIS = math.cos(math.radians(15.0))
"""Cosine of the angle to the turning axis within which a lidar looks along it."""
MAX_KNOWN_SHARE = 0.3
"""Standard error, as a share of the prior's, below which a parameter is known."""
FLOOR_HEIGHT = 0.1
"""Height of the middle of a plane below which it may be the floor [m]."""
FLOOR_SIGMA = math.radians(0.1)
"""Standard error of the lean of the axis by one floor [rad]: 3 mm of range error over 2 m, the
``PLANE_SIGMA`` of readings on either side."""
CONVERGED = 1e-4
"""Step, as a share of the prior standard deviations, after which no other is made."""
PLANE_SEARCHES, STEPS_PER_SEARCH = 4, 4
"""Searches for planes, each with better extrinsics, and Gauss-Newton steps after each search."""
WARNING_LIMITS = {
    "lateral": 0.008, "roll": math.radians(0.7), "pitch": math.radians(0.7), "yaw_scale": 0.03,
    "time_offset": 0.05,
}  # fmt: skip
"""Errors below which there is no warning: wheels of 0.6 % different radii already lean by 0.07
deg, and the wheel base is known to 1 %."""
WARNING_SIGMAS = 3.0
"""Errors below which there is no warning, in standard errors."""


@dataclass(frozen=True)
class Calibration:
    """The calibrated extrinsics and their uncertainty.

    Attributes:
        mount: Correction of the mount that the scans were taken with; 0 where it is not known.
        sigmas: Standard errors in the order of ``names`` (k,); infinite where not known.
        known: Whether the scans determine each parameter (k,).
        planes: Number of planes used.
        readings: Number of surfels on them.
        flatness: RMS distance of these surfels from their planes [m].
        names: The parameters that this scanner has, of ``PARAMETERS``, in their order (k,).
        turned_about: The one that turns the lidar about the axis itself, so that nothing can tell
            it from the zero of the angle.
        same_as: The lean of the axis that holds both; empty where that is the heading.
    """

    mount: MountConfig
    sigmas: FloatArray
    known: tuple[bool, ...]
    planes: int
    readings: int
    flatness: float
    names: tuple[str, ...]
    turned_about: str
    same_as: str


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is sought, and from what.

    Attributes:
        samples: The readings.
        sought: Indices in ``SOUGHT`` of what is sought (k,).
        prior: Their prior standard deviations (k,).
        has_curves: Whether each plane has a curve of range errors.
    """

    samples: Samples
    sought: IntArray
    prior: FloatArray
    has_curves: bool


def calibrate(places: Sequence[Sequence[RangeImage]], *, has_curves: bool = True) -> Calibration:
    """Return the extrinsics of the lidar from sweeps, grouped by the place they were taken from.

    Args:
        places: The sweeps of each place, which share one frame ``scan``; places are unrelated.
        has_curves: Whether the range errors of each plane are a curve over the range.

    Raises:
        RegistrationError: The sweeps show no planes.
    """
    # Start with the yaw scale
    samples = gather_samples(places, has_floor=has_curves)
    sought = choose_sought(samples, has_curves=has_curves)
    problem = _Problem(samples, sought, PRIOR_SIGMAS[sought], has_curves)
    values = np.zeros(len(SOUGHT))
    if samples.T_scan_axis is None:
        values[SOUGHT.index("yaw_scale")] = estimate_yaw_scale(places)

    # Alternate planes and Gauss-Newton steps
    before: list[int] = []
    for _ in range(PLANE_SEARCHES):
        planes = find_planes(samples.points(values), samples.normals_at(values), samples.places)
        if not planes:
            raise RegistrationError(
                "the scans show no wall or floor to calibrate by; scan a full turn in a room"
            )
        sizes = [len(plane) for plane in planes]
        for _ in range(STEPS_PER_SEARCH):
            H, g, fits = _build_equations(problem, planes, values)
            right = g.sum(axis=0) + values[sought] / problem.prior**2
            left = H.sum(axis=0) + np.diag(problem.prior**-2.0)
            step = np.linalg.solve(left, right)
            values[sought] = values[sought] - step
            if has_curves and np.all(np.abs(step) < CONVERGED * problem.prior):
                break
        if has_curves and sizes == before:
            break
        before = sizes

    # Keep what is determined
    errors = _jackknife_errors(H, g, values[sought], problem.prior)
    found = {
        SOUGHT[k]: (float(values[k]), float(sigma))
        for k, sigma in zip(sought, errors, strict=True)
        if sigma < MAX_KNOWN_SHARE * PRIOR_SIGMAS[k]
    }
    if samples.T_scan_axis is not None:
        found |= find_axis_lean(samples, values, planes, fits)
    names = _list_names(samples)
    count = sum(len(plane) for plane in planes)
    square = sum(float(np.sum(fit.eliminate(fit.residuals) ** 2)) for fit in fits)
    return Calibration(
        MountConfig(**{name: found[name][0] for name in names if name in found}),
        read_only([found[name][1] if name in found else math.inf for name in names]),
        tuple(name in found for name in names),
        len(planes),
        count,
        math.sqrt(square / count),
        names,
        "roll" if looks_along(samples) else "yaw",
        _find_twin_of_zero(samples),
    )


def _list_names(samples: Samples) -> tuple[str, ...]:
    """Return which of ``PARAMETERS`` a scanner has, in their order."""
    if samples.T_scan_axis is not None:
        return tuple(name for name in PARAMETERS if name != "yaw_scale")
    return PARAMETERS[:6] if looks_along(samples) else PARAMETERS[:5]


def _find_twin_of_zero(samples: Samples) -> str:
    """Return the lean that a wrong zero of the angle looks like; empty where it is the heading."""
    T = samples.T_scan_axis
    if T is None or is_vertical(T):
        return ""
    return "axis_roll" if is_ahead(T) else "axis_pitch"


def looks_along(samples: Samples) -> bool:
    """Return whether the lidar looks along the axis about which it is turned."""
    return bool(abs(samples.T_base_lidar[2, 0]) > ALONG_AXIS)


def choose_sought(samples: Samples, *, has_curves: bool) -> IntArray:
    """Return the indices in ``SOUGHT`` (k,) of what the scans may show.

    A turn of the lidar about the axis itself is not among it: that is its yaw, or its roll where it
    looks along the axis.
    """
    names = set(BASE_SOUGHT) - ({"range_error"} if has_curves else set())
    if samples.T_scan_axis is not None:
        names = names - {"yaw_scale"} | {"play"}
    if looks_along(samples):
        names = names - {"roll"} | {"yaw"}
    return np.flatnonzero([name in names for name in SOUGHT])


def calibrate_on_panorama(image: RangeImage) -> Calibration | None:
    """Return the extrinsics by one panorama; None where it shows no planes.

    None for a panorama by a turntable too: nothing of the base shows in it.
    """
    if image.T_scan_axis is not None:
        return None
    try:
        return calibrate([[image]], has_curves=False)
    except RegistrationError:
        return None


def describe_suspicion(found: Calibration | None) -> str:
    """Return a warning if a panorama has ``found`` wrong extrinsics; else an empty string.

    A run can go on with them: its views only fit less well.
    """
    if found is None:
        return ""
    sigmas = dict(zip(found.names, found.sigmas.tolist(), strict=True))
    if all(
        abs(getattr(found.mount, name)) <= max(limit, WARNING_SIGMAS * sigmas[name])
        for name, limit in WARNING_LIMITS.items()
    ):
        return ""
    return f"the lidar seems mounted {describe_mount(found.mount)}: run `twin calibrate lidar`"


def apply_yaw_scale(config: Config, found: Calibration | None) -> Config:
    """Return ``config`` with the yaw scale that the first panorama has ``found``, if wanted.

    The two ends of a full turn meet only with the right scale, which holds for all turns of this
    robot on this floor: later sweeps are corrected by it, and their yaws are assumed to be that
    much more accurate.
    """
    scale = PARAMETERS.index("yaw_scale")
    if config.sweep.turning == "odometry" or found is None or not found.known[scale]:
        return config
    mount = compose_mounts(config.mount, MountConfig(yaw_scale=found.mount.yaw_scale))
    left = math.hypot(float(found.sigmas[scale]), YAW_SCALE_REPEATABILITY)
    sigma = min(config.registration.yaw_scale_sigma, left)
    registration = replace(config.registration, yaw_scale_sigma=sigma)
    return replace(config, mount=mount, registration=registration)


def _build_equations(
    problem: _Problem, planes: list[IntArray], values: FloatArray
) -> tuple[FloatArray, FloatArray, list[PlaneFit]]:
    """Return the normal equations of each plane, and their fits.

    The normal and distance of each plane are those of the fitted plane; they are eliminated.

    Args:
        problem: What is sought.
        planes: Indices of the readings on each.
        values: The parameters (8,).

    Returns:
        Each plane's information matrix (p, k, k) and gradient (p, k), and its fit.
    """
    # Differentiate the points
    samples, k = problem.samples, len(problem.sought)
    P, moved = samples.points(values), samples.differentiate(values, problem.sought.tolist())
    by_range = samples.differentiate(values, [RANGE_ERROR])[0] if problem.has_curves else None

    # Sum up plane by plane
    H, g, fits = np.zeros((len(planes), k, k)), np.zeros((len(planes), k)), []
    for number, plane in enumerate(planes):
        rays = None if by_range is None else by_range[plane]
        fit = fit_plane(P[plane], samples.weights[plane], rays, samples.ranges[plane])
        J = np.stack([column[plane] @ fit.normal for column in moved], axis=1)
        J, e, w = fit.eliminate(J), fit.eliminate(fit.residuals), fit.weights
        H[number], g[number] = (J * w[:, None]).T @ J, J.T @ (w * e)
        fits.append(fit)
    return H, g, fits


def find_axis_lean(
    samples: Samples, values: FloatArray, planes: list[IntArray], fits: list[PlaneFit]
) -> dict[str, tuple[float, float]]:
    """Return the lean of the turntable's axis against the floor and its standard error [rad].

    With n the normal of the floor in the designed frame ``scan``, R^T e_z = n for the lean
    R = Ry(pitch) Rx(roll).
    """
    T = samples.T_scan_axis
    assert T is not None
    normals, weights = [], []
    for plane, fit in zip(planes, fits, strict=True):
        # Turn its normal up
        normal = T[:3, :3] @ fit.best_normal
        normal = normal if normal[2] > 0 else -normal
        height = T[2, :3] @ samples.points(values)[plane].mean(axis=0) + T[2, 3]
        if normal[2] > STEEP and abs(height) < FLOOR_HEIGHT:
            normals.append(normal)
            weights.append(float(len(plane)))
    if not normals:
        return {}
    n = np.average(normals, axis=0, weights=weights)
    lean = (math.atan2(n[1], n[2]), -math.asin(n[0] / float(np.linalg.norm(n))))
    sigma = FLOOR_SIGMA / math.sqrt(len(normals))
    return {"axis_roll": (lean[0], sigma), "axis_pitch": (lean[1], sigma)}


def _jackknife_errors(
    H: FloatArray, g: FloatArray, values: FloatArray, sigmas: FloatArray
) -> FloatArray:
    """Return standard errors (6,) by the jackknife: the scatter when each plane is left out.

    Args:
        H: Information matrix of each plane (p, 6, 6).
        g: Gradient of each plane (p, 6).
        values: The parameters (6,).
        sigmas: Their prior standard deviations (6,).
    """
    prior = np.diag(sigmas**-2.0)
    count = len(H)
    if count < 2:
        return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(H.sum(axis=0) + prior))))
    left, right = H.sum(axis=0) + prior, g.sum(axis=0) + values / sigmas**2
    steps = np.array([-np.linalg.solve(left - H[k], right - g[k]) for k in range(count)])
    spread = np.sum((steps - steps.mean(axis=0)) ** 2, axis=0) * (count - 1) / count
    floor = np.diagonal(np.linalg.inv(left))
    return np.asarray(np.sqrt(np.maximum(spread, floor)))
