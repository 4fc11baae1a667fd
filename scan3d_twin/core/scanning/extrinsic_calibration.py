"""Where the lidar really sits, from scans alone: planes stay planes only if the mount is right.

A lidar that is off to the side by y, leans by roll and looks down by pitch, whose heading is read
with a relative error k and late by tau, sees the reading r of beam d, taken while the base had the
heading psi and turned at w, at

    P = Rz((1 + k) psi + w tau) (t + y e_y + (r + b) R Ry(pitch) Rx(roll) d).

With the wrong values a wall bends: it turns about the axis by y / rho, so by more where it is
near; by roll in proportion to the height; the floor becomes a cone by pitch; and by k the first and
the last part of a full turn do not meet. What is wanted makes all planes of all sweeps flat,

    min  sum_j sum_i w_i (n_j . P_i - d_j)^2   over  y, roll, pitch, k, tau, b  and all (n_j, d_j),

by Gauss-Newton, the planes eliminated one by one (Schur complement). The range error b that all
readings share is a nuisance; that of single materials is left out. The late heading tau shows only
where sweeps to both sides were taken from one place: they share their planes. Standard errors come
from leaving out one plane after the other (jackknife), as surfaces err as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from scan3d_twin.core.config import Config, MountConfig
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import extract_surfels
from scan3d_twin.core.registration.surfels import VARIANCE, N, X
from scan3d_twin.core.scanning.extrinsics import composed, in_words, tilt, turn_rate
from scan3d_twin.core.types import FloatArray, IntArray, RangeImage, read_only

NAMES = ("lateral", "roll", "pitch", "yaw_scale", "time_offset")
"""What is estimated, in the units of ``MountConfig``; the range error follows them."""
PRIOR = np.array([0.05, 0.1, 0.1, 0.05, 0.2, 0.01])
"""Standard deviations assumed beforehand: what a person mounts by eye, and the lidar's data sheet
for the range error (+-10 mm)."""
STEP = 1e-4
"""For derivatives."""
ROBUST = 2.0
"""Kernel of Geman and McClure [sigma]."""
MIN_SEAM = 8
"""Lines at either end of a full turn that are compared, if no more of them overlap."""
KNOWN = 0.3
"""A value is known when its standard error is below this share of the prior's."""
STRIDE = 3
"""Every so manieth line and beam. Windows of surfels overlap a little then; every fifth, which
would make them independent, finds the lateral offset to 10 % in 3 robots of 10, this one in 8."""
NEAREST = 0.30
"""Readings nearer to the lidar than this may be the robot itself [m]."""
UNEVEN = 0.003
"""How flat a plane is as the lidar sees it [m]: its range error varies along a surface; within the
+-10 mm of the data sheet."""
WINDOW = 20.0
"""Readings that a surfel averages, at least."""
SEEDS, MOST_PLANES = 150, 12
"""Places at which a plane is looked for, and planes per place."""
NEAR, ALIKE = 0.04, math.cos(math.radians(10.0))
"""A plane's readings lie this near to it [m] with normals this much alike, at first ..."""
NEARER = 0.02
"""... and in the end [m]."""
LEAST, EXTENT = 60, 0.4
"""Readings of a plane, and its least extent [m]."""
ROUNDS, ITERATIONS = 4, 4
"""Searches for planes with ever better mounts, and steps with the same planes."""
TOLERABLE = np.array([0.008, math.radians(0.7), math.radians(0.7), 0.03, 0.05])
"""A mount that is off by less is no reason to warn: wheels of .6 % different radii already lean by
0.07 deg, and a wheel base is known to 1 % ..."""
SURE = 3.0
"""... nor is one that is off by less than so many standard errors."""
REPEATS = 0.002
"""By how much the yaw scale of a sweep may differ from that of a look around, one standard
deviation; three times the 0.0006 that benchmarks/mount.py finds in three_boxes."""
SEAM = math.radians(20.0)
"""Of either end of a full turn, compared to begin with [rad]."""


@dataclass(frozen=True)
class Calibration:
    """Where the lidar sits and how sure that is.

    Attributes:
        mount: Relative to what the scans were taken with; 0 where it is not known.
        sigmas: Their standard errors, in the order of ``NAMES`` (5,).
        known: Whether the scans say anything of each (5,).
        planes: Number of planes used.
        readings: Number of surfels on them.
        flatness: RMS distance of these from their planes [m].
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
        T_base_lidar: The mount they were taken with (4, 4).
        beams: Directions in ``lidar`` (m, 3).
        ranges: (m,) [m].
        yaws: Headings (m,) [rad].
        rates: How fast the base turned (m,) [rad/s].
        weights: Inverse variances of the distance from a plane (m,) [1/m2].
        normals: In ``scan`` (m, 3).
        places: Number of the place each was taken from (m,).
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
        """Return the points (m, 3) under the mount ``values`` (6,); the module's equation."""
        y, roll, pitch, _, _, b = values
        R, t = self.T_base_lidar[:3, :3] @ tilt(roll, pitch), self.T_base_lidar[:3, 3]
        at = t + (self.ranges + b)[:, None] * (self.beams @ R.T)
        at[:, 1] += y
        return _turned(at, self.headings(values))

    def headings(self, values: FloatArray) -> FloatArray:
        """Return the true headings (m,) [rad]."""
        return np.asarray((1.0 + values[3]) * self.yaws + values[4] * self.rates)

    def normals_at(self, values: FloatArray) -> FloatArray:
        """Return the normals (m, 3), turned along with their readings."""
        return _turned(self.normals, self.headings(values) - self.yaws)


def calibrate(places: Sequence[Sequence[RangeImage]]) -> Calibration:
    """Return where the lidar sits, from sweeps grouped by the place they were taken from.

    Args:
        places: Sweeps from one place must have one frame ``scan``; different places are unrelated.

    Raises:
        RegistrationError: The sweeps show no planes.
    """
    samples = _gather(places)
    values = np.zeros(6)
    values[3] = _seam(places)
    for _ in range(ROUNDS):
        planes = find_planes(samples.points(values), samples.normals_at(values), samples.places)
        if not planes:
            raise RegistrationError(
                "the scans show no wall or floor to calibrate by; scan a full turn in a room"
            )
        for _ in range(ITERATIONS):
            H, g, square = _equations(samples, planes, values)
            right = g.sum(axis=0) + values / PRIOR**2
            values = values - np.linalg.solve(H.sum(axis=0) + np.diag(PRIOR**-2.0), right)
    sigmas = _standard_errors(H, g, values)[:5]
    known = sigmas < KNOWN * PRIOR[:5]
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
    """Return what a look around says of the mount it was taken with; None if nothing."""
    try:
        return calibrate([[image]])
    except RegistrationError:
        return None


def suspicion(found: Calibration | None) -> str:
    """Return what a look around says against the mount that it was taken with; empty if nothing.

    A run goes on all the same: the views only fit worse than they could.
    """
    if found is None:
        return ""
    values = np.array(astuple(found.mount))
    if not np.any(np.abs(values) > np.maximum(TOLERABLE, SURE * found.sigmas)):
        return ""
    return f"the lidar seems mounted {in_words(found.mount)}: run `twin calibrate lidar`"


def with_turning(config: Config, found: Calibration | None) -> Config:
    """Return ``config`` with the yaw scale that the first look around has ``found``, if wanted.

    The two ends of its full turn meet only with the right scale, which is that of all turns of this
    robot on this floor: sweeps to come are corrected by it and registered as that much surer.
    """
    scale = NAMES.index("yaw_scale")
    if config.sweep.turning == "odometry" or found is None or not found.known[scale]:
        return config
    mount = composed(config.mount, MountConfig(yaw_scale=found.mount.yaw_scale))
    left = math.hypot(float(found.sigmas[scale]), REPEATS)
    sigma = min(config.registration.yaw_scale_sigma, left)
    registration = replace(config.registration, yaw_scale_sigma=sigma)
    return replace(config, mount=mount, registration=registration)


def _gather(places: Sequence[Sequence[RangeImage]]) -> Samples:
    images = [image for group in places for image in group]
    if not images:
        raise RegistrationError("there is no scan to calibrate by")
    T = images[0].T_base_lidar
    if any(not np.allclose(image.T_base_lidar, T, atol=1e-9) for image in images):
        raise ConfigError("the scans were taken with different mounts: calibrate them one by one")
    parts = [_sample(image, place) for place, group in enumerate(places) for image in group]
    return Samples(T, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _sample(image: RangeImage, place: int) -> tuple[FloatArray | IntArray, ...]:
    """Return the fields of ``Samples`` for one sweep, the mean of each window as its reading."""
    table = extract_surfels(image).at(np.s_[::STRIDE, ::STRIDE])
    yaws, e = image.yaws[::STRIDE, ::STRIDE], image.spec.elevations[::STRIDE]
    beams = np.stack([np.cos(e), np.zeros_like(e), np.sin(e)], axis=1)
    lidar = _turned(np.broadcast_to(image.T_base_lidar[:3, 3], (*yaws.shape, 3)), yaws)
    ranges = np.linalg.norm(table[..., X] - lidar, axis=2)
    line, beam = np.nonzero((table[..., VARIANCE] > 0) & (ranges > NEAREST))
    n = len(line)
    return (
        beams[beam],
        ranges[line, beam],
        yaws[line, beam],
        np.full(n, turn_rate(image)),
        1.0 / (table[line, beam, VARIANCE] / WINDOW + UNEVEN**2),
        table[line, beam, N],
        np.full(n, place),
    )


def _turned(vectors: FloatArray, yaws: FloatArray) -> FloatArray:
    c, s = np.cos(yaws), np.sin(yaws)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _seam(places: Sequence[Sequence[RangeImage]]) -> float:
    """Return the yaw scale by which both ends of full turns meet; 0 where no turn is full."""
    found = [
        turn / math.tau
        for images in places
        for image in images
        if (turn := _gap(image)) is not None
    ]
    return float(np.median(found)) if found else 0.0


def _gap(image: RangeImage) -> float | None:
    """Return by how much more than shown a full turn was [rad]; None if it was none.

    Normals of a surface seen at both ends differ by that angle, wherever their points lie. Lines
    are ordered by falling yaw, so the first ones see again what the last ones did.
    """
    middle = image.yaws[:, image.spec.n_beams // 2]
    turn = float(middle[0] - middle[-1])
    if turn < math.tau - SEAM / 4:
        return None
    count = max(MIN_SEAM, int(np.count_nonzero(middle >= middle[-1] + math.tau)))
    grid = extract_surfels(image)
    a, b = grid.at(np.s_[:count, :]), grid.at(np.s_[-count:, :])
    both = (a[..., VARIANCE] > 0) & (b[..., VARIANCE] > 0)
    n, m = a[both][:, N], b[both][:, N]
    upright = (np.abs(n[:, 2]) < 0.5) & (np.sum(n * m, axis=1) > math.cos(SEAM))
    if np.count_nonzero(upright) < LEAST:
        return None
    n, m = n[upright], m[upright]
    across = n[:, 0] * m[:, 1] - n[:, 1] * m[:, 0]
    return float(np.median(np.arctan2(across, np.sum(n[:, :2] * m[:, :2], axis=1))))


def find_planes(points: FloatArray, normals: FloatArray, places: IntArray) -> list[IntArray]:
    """Return the readings of each plane, largest first, place by place."""
    found = []
    for place in np.unique(places):
        free = np.flatnonzero(places == place)
        for _ in range(MOST_PLANES):
            plane = _largest(points, normals, free)
            if plane is None:
                break
            found.append(plane)
            free = np.setdiff1d(free, plane, assume_unique=True)
    return found


def _largest(points: FloatArray, normals: FloatArray, free: IntArray) -> IntArray | None:
    """Return the readings among ``free`` on the plane that most of them share; None for none."""
    if len(free) < LEAST:
        return None
    P, n = points[free], normals[free]
    seeds = np.linspace(0, len(free) - 1, SEEDS).astype(np.int64)
    near = np.abs(n[seeds] @ P.T - np.sum(n[seeds] * P[seeds], axis=1)[:, None]) < NEAR
    on = near & (n[seeds] @ n.T > ALIKE)
    best = on[int(np.argmax(on.sum(axis=1)))]
    for gate in (NEAR, NEARER, NEARER):
        if np.count_nonzero(best) < LEAST:
            return None
        centre = P[best].mean(axis=0)
        Q = P[best] - centre
        squares, axes = np.linalg.eigh(Q.T @ Q)
        normal = axes[:, 0] * np.sign(axes[:, 0] @ n[best].mean(axis=0))
        best = (np.abs((P - centre) @ normal) < gate) & (n @ normal > ALIKE)
    extent = math.sqrt(12.0 * squares[1] / np.count_nonzero(best))
    return free[best] if np.count_nonzero(best) >= LEAST and extent > EXTENT else None


def _equations(
    samples: Samples, planes: list[IntArray], values: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return each plane's part of the information (p, 6, 6) and gradient (p, 6), and the squares.

    With its own normal and distance eliminated: they are those of the plane fitted to it.
    """
    P = samples.points(values)
    moved = [
        (samples.points(values + step) - samples.points(values - step)) / (2 * STEP)
        for step in STEP * np.eye(6)
    ]
    H, g, square = np.zeros((len(planes), 6, 6)), np.zeros((len(planes), 6)), 0.0
    for k, plane in enumerate(planes):
        w = samples.weights[plane]
        centre = w @ P[plane] / w.sum()
        Q = P[plane] - centre
        _, axes = np.linalg.eigh((Q * w[:, None]).T @ Q)
        e = Q @ axes[:, 0]
        w = w * (ROBUST**2 / (ROBUST**2 + w * e * e)) ** 2
        J = np.stack([column[plane] @ axes[:, 0] for column in moved], axis=1)
        own = np.column_stack([np.ones(len(plane)), Q @ axes[:, 1:]])
        W = own * w[:, None]
        A = np.linalg.inv(own.T @ W)
        J = J - own @ (A @ (W.T @ J))
        e = e - own @ (A @ (W.T @ e))
        H[k], g[k] = (J * w[:, None]).T @ J, J.T @ (w * e)
        square += float(e @ e)
    return H, g, square


def _standard_errors(H: FloatArray, g: FloatArray, values: FloatArray) -> FloatArray:
    """Return the jackknife's standard errors (6,): the scatter when each plane is left out once."""
    prior = np.diag(PRIOR**-2.0)
    count = len(H)
    if count < 2:
        return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(H.sum(axis=0) + prior))))
    left, right = H.sum(axis=0) + prior, g.sum(axis=0) + values / PRIOR**2
    steps = np.array([-np.linalg.solve(left - H[k], right - g[k]) for k in range(count)])
    spread = np.sum((steps - steps.mean(axis=0)) ** 2, axis=0) * (count - 1) / count
    floor = np.diagonal(np.linalg.inv(left))
    return np.asarray(np.sqrt(np.maximum(spread, floor)))
