"""Extrinsic calibration of the lidar from scans alone: the right extrinsics keep planes flat.

Let the lidar be off to the side by y, lean by roll and look down by pitch, and let the heading have
a relative error k and a delay tau. The reading r of beam d, taken at heading psi and turn rate w,
is then at

    P = Rz((1 + k) psi + w tau) (t + y e_y + (r + b) R Ry(pitch) Rx(roll) d).

Wrong values bend a wall: y rotates it about the axis by y / rho, that is more where it is nearer;
roll rotates it in proportion to the height; pitch makes a cone of the floor; k separates the two
ends of a full turn. Calibration minimises the distances of all readings from their planes,

    min  sum_j sum_i w_i (n_j . P_i - d_j)^2   over  y, roll, pitch, k, tau, b  and all (n_j, d_j),

by Gauss-Newton with the planes eliminated one by one (Schur complement). The range error b that all
readings share is a nuisance parameter; errors of single materials are not modelled. The delay tau
is observable only if sweeps in both directions were taken from one place, as these share their
planes. Standard errors are by the jackknife, leaving out one plane after the other, as the readings
of a surface err together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.config import Config, MountConfig
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import extract_surfels
from scan3d_twin.core.registration.surfels import VARIANCE, N, X
from scan3d_twin.core.scanning.extrinsics import (
    compose_mounts,
    describe_mount,
    measure_turn_rate,
    tilt_matrix,
)
from scan3d_twin.core.scanning.half_turn import is_unfolded
from scan3d_twin.core.types import FloatArray, IntArray, RangeImage, read_only

PARAMETERS = ("lateral", "roll", "pitch", "yaw_scale", "time_offset")
"""The estimated fields of ``MountConfig``; in parameter vectors the range error follows them."""
PRIOR_SIGMAS = np.array([0.05, 0.1, 0.1, 0.05, 0.2, 0.01])
"""Prior standard deviations of the parameters: a mount aligned by eye, and for the range error the
lidar's data sheet (+-10 mm)."""
ALONG_AXIS = math.cos(math.radians(15.0))
"""Cosine of the angle to the turning axis within which a lidar looks along it."""
FIXED_SIGMA = 1e-9
"""Prior standard deviation of a parameter that stays 0."""
DERIVATIVE_STEP = 1e-4
"""Step of numerical derivatives, in the units of the parameters."""
KERNEL_WIDTH = 2.0
"""Width of the Geman-McClure kernel [sigma]."""
MIN_SEAM_LINES = 8
"""Smallest number of lines at either end of a full turn that are compared."""
MAX_KNOWN_SHARE = 0.3
"""Standard error, as a share of the prior's, below which a parameter is known."""
STRIDE = 3
"""Stride of the lines and beams used. The windows of surfels overlap slightly; a stride of 5, with
independent windows, finds the lateral offset to 10 % in 3 robots of 10, this one in 8."""
MIN_RANGE = 0.30
"""Range below which readings may be the robot itself [m]."""
PLANE_SIGMA = 0.003
"""Deviation of a measured plane from flatness, one standard deviation [m]: the range error varies
along a surface, within the +-10 mm of the data sheet."""
READINGS_PER_SURFEL = 20.0
"""Smallest number of readings that a surfel averages."""
PLANE_SEEDS, MAX_PLANES = 150, 12
"""Surfels tried as the start of a plane, and largest number of planes per place."""
FIRST_PLANE_DISTANCE, MIN_NORMAL_COSINE = 0.04, math.cos(math.radians(10.0))
"""Largest distance of a reading from its plane in the first fit [m], and smallest cosine of the
angle between their normals."""
FINAL_PLANE_DISTANCE = 0.02
"""Largest distance of a reading from its plane in later fits [m]."""
MIN_PLANE_READINGS, MIN_PLANE_EXTENT = 60, 0.4
"""Smallest number of readings of a plane, and its smallest extent [m]."""
PLANE_SEARCHES, STEPS_PER_SEARCH = 4, 4
"""Searches for planes, each with better extrinsics, and Gauss-Newton steps after each search."""
WARNING_LIMITS = np.array([0.008, math.radians(0.7), math.radians(0.7), 0.03, 0.05])
"""Errors of the parameters below which there is no warning: wheels of 0.6 % different radii already
lean by 0.07 deg, and the wheel base is known to 1 %."""
WARNING_SIGMAS = 3.0
"""Errors below which there is no warning, in standard errors."""
YAW_SCALE_REPEATABILITY = 0.002
"""Standard deviation of the yaw scale of a sweep from that of the panorama; three times the 0.0006
that benchmarks/mount.py finds in three_boxes."""
SEAM_ANGLE = math.radians(20.0)
"""Largest mismatch of the two ends of a full turn that is corrected [rad]."""


_Part = tuple[slice, slice]
"""Lines and beams of a part of a range image."""


@dataclass(frozen=True)
class Calibration:
    """The calibrated extrinsics and their uncertainty.

    Attributes:
        mount: Correction of the mount that the scans were taken with; 0 where it is not known.
        sigmas: Standard errors in the order of ``PARAMETERS`` (5,).
        known: Whether the scans determine each parameter (5,).
        planes: Number of planes used.
        readings: Number of surfels on them.
        flatness: RMS distance of these surfels from their planes [m].
    """

    mount: MountConfig
    sigmas: FloatArray
    known: tuple[bool, ...]
    planes: int
    readings: int
    flatness: float


@dataclass(frozen=True)
class Samples:
    """Surfels of all sweeps, each as one reading.

    Attributes:
        T_base_lidar: The mount that the sweeps were taken with (4, 4).
        beams: Directions in ``lidar`` (m, 3).
        ranges: Ranges (m,) [m].
        yaws: Headings (m,) [rad].
        rates: Turn rates of the base (m,) [rad/s].
        weights: Inverse variances of the distance from a plane (m,) [1/m2].
        normals: Unit normals in ``scan`` (m, 3).
        places: Number of the place that each was taken from (m,).
    """

    T_base_lidar: FloatArray
    beams: FloatArray
    ranges: FloatArray
    yaws: FloatArray
    rates: FloatArray
    weights: FloatArray
    normals: FloatArray
    places: IntArray

    def points(self, values: FloatArray) -> FloatArray:
        """Return the points (m, 3) for the parameters ``values`` (6,), by the module's equation."""
        y, roll, pitch, _, _, b = values
        R, t = self.T_base_lidar[:3, :3] @ tilt_matrix(roll, pitch), self.T_base_lidar[:3, 3]
        at = t + (self.ranges + b)[:, None] * (self.beams @ R.T)
        at[:, 1] += y
        return _rotate(at, self.headings(values))

    def headings(self, values: FloatArray) -> FloatArray:
        """Return the headings (m,) corrected by the parameters ``values`` (6,) [rad]."""
        return np.asarray((1.0 + values[3]) * self.yaws + values[4] * self.rates)

    def normals_at(self, values: FloatArray) -> FloatArray:
        """Return the normals (m, 3), rotated together with their readings."""
        return _rotate(self.normals, self.headings(values) - self.yaws)


def calibrate(places: Sequence[Sequence[RangeImage]]) -> Calibration:
    """Return the extrinsics of the lidar from sweeps, grouped by the place they were taken from.

    Args:
        places: The sweeps of each place, which share one frame ``scan``; places are unrelated.

    Raises:
        RegistrationError: The sweeps show no planes.
    """
    # Start with the yaw scale
    samples = _gather_samples(places)
    prior = _find_prior(samples.T_base_lidar)
    values = np.zeros(6)
    values[3] = _estimate_yaw_scale(places)

    # Alternate planes and Gauss-Newton steps
    for _ in range(PLANE_SEARCHES):
        planes = find_planes(samples.points(values), samples.normals_at(values), samples.places)
        if not planes:
            raise RegistrationError(
                "the scans show no wall or floor to calibrate by; scan a full turn in a room"
            )
        for _ in range(STEPS_PER_SEARCH):
            H, g, square = _build_equations(samples, planes, values)
            right = g.sum(axis=0) + values / prior**2
            values = values - np.linalg.solve(H.sum(axis=0) + np.diag(prior**-2.0), right)

    # Keep what is determined
    sigmas = _jackknife_errors(H, g, values, prior)[:5]
    known = (sigmas < MAX_KNOWN_SHARE * PRIOR_SIGMAS[:5]) & (prior[:5] == PRIOR_SIGMAS[:5])
    sigmas = np.where(prior[:5] == PRIOR_SIGMAS[:5], sigmas, PRIOR_SIGMAS[:5])
    count = sum(len(plane) for plane in planes)
    return Calibration(
        MountConfig(*np.where(known, values[:5], 0.0).tolist()),
        read_only(sigmas),
        tuple(known.tolist()),
        len(planes),
        count,
        math.sqrt(square / count),
    )


def calibrate_on_panorama(image: RangeImage) -> Calibration | None:
    """Return the extrinsics by one panorama; None where it shows no planes.

    None for a panorama by a turntable too: nothing of the base shows in it.
    """
    if image.T_scan_axis is not None:
        return None
    try:
        return calibrate([[image]])
    except RegistrationError:
        return None


def describe_suspicion(found: Calibration | None) -> str:
    """Return a warning if a panorama has ``found`` wrong extrinsics; else an empty string.

    A run can go on with them: its views only fit less well.
    """
    if found is None:
        return ""
    values = np.array([getattr(found.mount, name) for name in PARAMETERS])
    if not np.any(np.abs(values) > np.maximum(WARNING_LIMITS, WARNING_SIGMAS * found.sigmas)):
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


def _gather_samples(places: Sequence[Sequence[RangeImage]]) -> Samples:
    """Return the surfels of all sweeps; errors if there are none, or of different mounts."""
    images = [image for group in places for image in group]
    if not images:
        raise RegistrationError("there is no scan to calibrate by")
    T = images[0].T_base_lidar
    if any(not np.allclose(image.T_base_lidar, T, atol=1e-9) for image in images):
        raise ConfigError("the scans were taken with different mounts: calibrate them one by one")
    parts = [_sample_sweep(image, place) for place, group in enumerate(places) for image in group]
    return Samples(T, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _sample_sweep(image: RangeImage, place: int) -> tuple[FloatArray | IntArray, ...]:
    """Return the fields of ``Samples`` for one sweep, each surfel's mean as its reading."""
    # Express the surfels as readings
    grid = extract_surfels(image)
    image, table = grid.image, grid.at(np.s_[::STRIDE, ::STRIDE])
    yaws = image.yaws[::STRIDE, ::STRIDE]
    lidar = _rotate(np.broadcast_to(image.T_base_lidar[:3, 3], (*yaws.shape, 3)), yaws)
    ranges = np.linalg.norm(table[..., X] - lidar, axis=2)

    # Select those beyond the robot
    line, beam = np.nonzero((table[..., VARIANCE] > 0) & (ranges > MIN_RANGE))
    n, e = len(line), image.elevations_at(STRIDE * line, STRIDE * beam)
    beams = np.stack([np.cos(e), np.zeros_like(e), np.sin(e)], axis=1)
    measured, headings = ranges[line, beam], yaws[line, beam]
    if is_unfolded(image):
        behind = np.abs(image.yaws[:, image.spec.n_beams // 2][STRIDE * line]) > math.pi / 2
        headings = np.where(behind, headings - np.copysign(math.pi, headings), headings)
        at = _rotate(table[line, beam, X], -headings) - image.T_base_lidar[:3, 3]
        seen = at @ image.T_base_lidar[:3, :3]
        beams[behind] = (seen / np.linalg.norm(seen, axis=1, keepdims=True))[behind]
        measured = np.where(behind, np.linalg.norm(seen, axis=1), measured)
    return (
        beams,
        measured,
        headings,
        np.full(n, measure_turn_rate(image)),
        1.0 / (table[line, beam, VARIANCE] / READINGS_PER_SURFEL + PLANE_SIGMA**2),
        table[line, beam, N],
        np.full(n, place),
    )


def _rotate(vectors: FloatArray, yaws: FloatArray) -> FloatArray:
    """Return ``vectors`` (..., 3), rotated about z by ``yaws`` (...) [rad]."""
    c, s = np.cos(yaws), np.sin(yaws)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _estimate_yaw_scale(places: Sequence[Sequence[RangeImage]]) -> float:
    """Return the yaw scale with which both ends of full turns meet; 0 if there is no full turn."""
    found = [
        scale
        for images in places
        for image in images
        if (scale := _measure_seams(image)) is not None
    ]
    return float(np.median(found)) if found else 0.0


def _measure_seams(image: RangeImage) -> float | None:
    """Return the share by which a turn exceeds its measured angle; None if it leaves a gap.

    The normals of a surface that is seen at both ends of a turn differ by the excess, wherever its
    points are.
    """
    seams, turn = _find_seams(image)
    if not seams:
        return None
    grid = extract_surfels(image)
    found = np.concatenate([_compare_normals(grid.at(a), grid.at(b)) for a, b in seams])
    return float(np.median(found)) / turn if len(found) >= MIN_PLANE_READINGS else None


def _find_seams(image: RangeImage) -> tuple[list[tuple[_Part, _Part]], float]:
    """Return the parts of ``image`` that show a place before and after a turn, and its angle [rad].

    Lines are ordered by falling yaw: the first lines of a full turn see again what the last ones
    saw. What is a quarter turn to either side is seen at both ends of half a turn, by the one half
    of the revolutions and by the other (``half_turn``). There is no part if the turn leaves a gap.
    """
    middle = image.yaws[:, image.spec.n_beams // 2]
    if is_unfolded(image):
        ends = [int(np.searchsorted(-middle, angle)) for angle in (-math.pi / 2, math.pi / 2)]
        count = MIN_SEAM_LINES
        if ends[0] < count or ends[1] + count > image.n_lines:
            return [], math.pi
        return [
            ((slice(end, end + count), slice(None)), (slice(end - count, end), slice(None)))
            for end in ends
        ], math.pi
    turn = float(middle[0] - middle[-1])
    if turn < math.tau - SEAM_ANGLE / 4:
        return [], math.tau
    count = max(MIN_SEAM_LINES, int(np.count_nonzero(middle >= middle[-1] + math.tau)))
    return [((slice(count), slice(None)), (slice(-count, None), slice(None)))], math.tau


def _compare_normals(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles (n,) [rad] from the normals of surfels ``a`` to those of ``b``."""
    both = (a[..., VARIANCE] > 0) & (b[..., VARIANCE] > 0)
    n, m = a[both][:, N], b[both][:, N]
    upright = (np.abs(n[:, 2]) < 0.5) & (np.sum(n * m, axis=1) > math.cos(SEAM_ANGLE))
    n, m = n[upright], m[upright]
    across = n[:, 0] * m[:, 1] - n[:, 1] * m[:, 0]
    return np.asarray(np.arctan2(across, np.sum(n[:, :2] * m[:, :2], axis=1)))


def find_planes(points: FloatArray, normals: FloatArray, places: IntArray) -> list[IntArray]:
    """Return the indices of the readings on each plane, place by place, the largest plane first."""
    found = []
    for place in np.unique(places):
        free = np.flatnonzero(places == place)
        for _ in range(MAX_PLANES):
            plane = _find_largest_plane(points, normals, free)
            if plane is None:
                break
            found.append(plane)
            free = np.setdiff1d(free, plane, assume_unique=True)
    return found


def _find_largest_plane(points: FloatArray, normals: FloatArray, free: IntArray) -> IntArray | None:
    """Return the readings among ``free`` on the plane with the most of them; None if too few."""
    if len(free) < MIN_PLANE_READINGS:
        return None

    # Choose the seed with most readings
    P, n = points[free], normals[free]
    seeds = np.linspace(0, len(free) - 1, PLANE_SEEDS).astype(np.int64)
    near = (
        np.abs(n[seeds] @ P.T - np.sum(n[seeds] * P[seeds], axis=1)[:, None]) < FIRST_PLANE_DISTANCE
    )
    on = near & (n[seeds] @ n.T > MIN_NORMAL_COSINE)
    best = on[int(np.argmax(on.sum(axis=1)))]

    # Fit a plane and gather again
    for gate in (FIRST_PLANE_DISTANCE, FINAL_PLANE_DISTANCE, FINAL_PLANE_DISTANCE):
        if np.count_nonzero(best) < MIN_PLANE_READINGS:
            return None
        centre = P[best].mean(axis=0)
        Q = P[best] - centre
        squares, axes = np.linalg.eigh(Q.T @ Q)
        normal = axes[:, 0] * np.sign(axes[:, 0] @ n[best].mean(axis=0))
        best = (np.abs((P - centre) @ normal) < gate) & (n @ normal > MIN_NORMAL_COSINE)

    # Require readings and extent
    extent = math.sqrt(12.0 * squares[1] / np.count_nonzero(best))
    return (
        free[best]
        if np.count_nonzero(best) >= MIN_PLANE_READINGS and extent > MIN_PLANE_EXTENT
        else None
    )


def _build_equations(
    samples: Samples, planes: list[IntArray], values: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return the normal equations of each plane and the sum of squares.

    The normal and distance of each plane are those of the fitted plane; they are eliminated.

    Returns:
        Each plane's information matrix (p, 6, 6) and gradient (p, 6), and the sum of the squared
        distances from the planes [m2].
    """
    # Differentiate the points
    P = samples.points(values)
    moved = [
        (samples.points(values + step) - samples.points(values - step)) / (2 * DERIVATIVE_STEP)
        for step in DERIVATIVE_STEP * np.eye(6)
    ]

    # Sum up plane by plane
    H, g, square = np.zeros((len(planes), 6, 6)), np.zeros((len(planes), 6)), 0.0
    for k, plane in enumerate(planes):
        # Fit the plane
        w = samples.weights[plane]
        centre = w @ P[plane] / w.sum()
        Q = P[plane] - centre
        _, axes = np.linalg.eigh((Q * w[:, None]).T @ Q)
        e = Q @ axes[:, 0]
        w = w * (KERNEL_WIDTH**2 / (KERNEL_WIDTH**2 + w * e * e)) ** 2

        # Eliminate its normal and distance
        J = np.stack([column[plane] @ axes[:, 0] for column in moved], axis=1)
        own = np.column_stack([np.ones(len(plane)), Q @ axes[:, 1:]])
        W = own * w[:, None]
        A = np.linalg.inv(own.T @ W)
        J = J - own @ (A @ (W.T @ J))
        e = e - own @ (A @ (W.T @ e))

        # Add the rest
        H[k], g[k] = (J * w[:, None]).T @ J, J.T @ (w * e)
        square += float(e @ e)
    return H, g, square


def _find_prior(T_axis_lidar: FloatArray) -> FloatArray:
    """Return the prior standard deviations of the parameters for a lidar that is mounted so (6,).

    A lidar that looks along the axis about which it is turned rolls about it too: planes do not
    tell its roll from the zero of the angle, so that it stays 0.
    """
    sigmas = PRIOR_SIGMAS.copy()
    if abs(T_axis_lidar[2, 0]) > ALONG_AXIS:
        sigmas[PARAMETERS.index("roll")] = FIXED_SIGMA
    return sigmas


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
