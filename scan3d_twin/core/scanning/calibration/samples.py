"""Readings for the calibration of the extrinsics: the surfels of sweeps, each as one reading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import extract_surfels
from scan3d_twin.core.registration.surfels.extraction import VARIANCE, N, X
from scan3d_twin.core.scanning.calibration.extrinsics import (
    measure_turn_rate,
    tilt_matrix,
    yaw_matrix,
)
from scan3d_twin.core.scanning.calibration.half_turn import is_unfolded
from scan3d_twin.core.scanning.calibration.planes import MIN_PLANE_READINGS
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, RangeImage

MIN_SEAM_LINES = 8
"""Smallest number of lines at either end of a full turn that are compared."""
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
FLOOR_BLOCK = 5
"""Lines and beams of the blocks of readings on the floor: two by two degrees."""
FLOOR_BAND = 0.08
"""Height below which readings may be on the floor [m]: 2 degrees of tilt at 2 m, and some."""
READING_SIGMA = 0.0056
"""Range noise of a reading in means of many, standard deviation [m]; docs/registration.md."""
SEAM_ANGLE = math.radians(20.0)
"""Largest mismatch of the two ends of a full turn that is corrected [rad]."""
DERIVATIVE_STEP = 1e-4
"""Step of numerical derivatives, in the units of the parameters."""
TURNING = (3, 4, 7)
"""Parameters that change the headings: yaw scale, time offset and play."""

_Part = tuple[slice, slice]
"""Lines and beams of a part of a range image."""


@dataclass(frozen=True)
class Samples:
    """Surfels of all sweeps, each as one reading.

    Attributes:
        T_base_lidar: The mount that the sweeps were taken with (4, 4).
        T_scan_axis: Pose of the turntable's axis (4, 4); None where the base turned.
        beams: Directions in ``lidar`` (m, 3).
        ranges: Ranges (m,) [m].
        yaws: Headings (m,) [rad].
        rates: Turn rates of the base (m,) [rad/s].
        weights: Inverse variances of the distance from a plane (m,) [1/m2].
        normals: Unit normals in ``scan`` (m, 3).
        places: Number of the place that each was taken from (m,).
    """

    T_base_lidar: FloatArray
    T_scan_axis: FloatArray | None
    beams: FloatArray
    ranges: FloatArray
    yaws: FloatArray
    rates: FloatArray
    weights: FloatArray
    normals: FloatArray
    places: IntArray

    def points(self, values: FloatArray) -> FloatArray:
        """Return the points (m, 3) for the parameters ``values`` (8,), by the module's equation."""
        return _turn(self._before_turn(values), self._turn_by(values))

    def differentiate(self, values: FloatArray, entries: Sequence[int]) -> list[FloatArray]:
        """Return the derivatives (m, 3) of the points by ``entries`` of ``values`` (8,), in order.

        They are central differences. Most parameters leave the headings as they are.
        """
        found, turn = [], self._turn_by(values)
        for step in DERIVATIVE_STEP * np.eye(len(values))[[*entries]]:
            ahead, behind = (
                _turn(self._before_turn(at), self._turn_by(at) if step[[*TURNING]].any() else turn)
                for at in (values + step, values - step)
            )
            found.append((ahead - behind) / (2 * DERIVATIVE_STEP))
        return found

    def _before_turn(self, values: FloatArray) -> FloatArray:
        """Return the points (m, 3) in what is turned."""
        y, roll, pitch, _, _, b, yaw, _ = values
        R, t = self.T_base_lidar[:3, :3], self.T_base_lidar[:3, 3]
        R = R @ yaw_matrix(yaw) if yaw else R
        R = R @ tilt_matrix(roll, pitch)
        at = t + (self.ranges + b)[:, None] * (self.beams @ R.T)
        at[:, 1] += y
        return np.asarray(at)

    def _turn_by(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return cosine and sine of the headings (m,)."""
        headings = self.headings(values)
        return np.cos(headings), np.sin(headings)

    def headings(self, values: FloatArray) -> FloatArray:
        """Return the headings (m,) corrected by the parameters ``values`` (8,) [rad]."""
        turned = (1.0 + values[3]) * self.yaws + values[4] * self.rates
        if values[7]:
            turned = turned - values[7] / 2 * np.sign(self.rates)
        return np.asarray(turned)

    def normals_at(self, values: FloatArray) -> FloatArray:
        """Return the normals (m, 3), rotated together with their readings."""
        return _rotate(self.normals, self.headings(values) - self.yaws)


def gather_samples(places: Sequence[Sequence[RangeImage]], *, has_floor: bool = False) -> Samples:
    """Return the surfels of all sweeps; errors if there are none, or of different mounts.

    Args:
        places: The sweeps of each place.
        has_floor: Whether readings near the floor count too, where lines are too close for surfels.
    """
    images = [image for group in places for image in group]
    if not images:
        raise RegistrationError("there is no scan to calibrate by")
    first = images[0]
    if any(not _have_same_mount(image, first) for image in images):
        raise ConfigError("the scans were taken with different mounts: calibrate them one by one")
    parts = [_sample_sweep(image, place) for place, group in enumerate(places) for image in group]
    if has_floor:
        parts += [_sample_floor(image, k) for k, group in enumerate(places) for image in group]
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Samples(first.T_base_lidar, first.T_scan_axis, *columns)


def _have_same_mount(a: RangeImage, b: RangeImage) -> bool:
    """Return whether two sweeps were turned by the same axis, and taken with the same mount."""
    if (a.T_scan_axis is None) != (b.T_scan_axis is None):
        return False
    same = np.allclose(a.T_base_lidar, b.T_base_lidar, atol=1e-9)
    if a.T_scan_axis is not None and b.T_scan_axis is not None:
        same = same and np.allclose(a.T_scan_axis, b.T_scan_axis, atol=1e-9)
    return bool(same)


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
        seen, reach = _find_beams(image, table[line, beam, X], headings)
        beams[behind] = seen[behind]
        measured = np.where(behind, reach, measured)
    return (
        beams,
        measured,
        headings,
        np.full(n, measure_turn_rate(image)),
        1.0 / (table[line, beam, VARIANCE] / READINGS_PER_SURFEL + PLANE_SIGMA**2),
        table[line, beam, N],
        np.full(n, place),
    )


def _find_beams(
    image: RangeImage, points: FloatArray, headings: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the beams (n, 3) that see ``points`` (n, 3) at ``headings`` (n,), and ranges (n,)."""
    at = _rotate(points, -headings) - image.T_base_lidar[:3, 3]
    seen = at @ image.T_base_lidar[:3, :3]
    reach = np.linalg.norm(seen, axis=1)
    return seen / reach[:, None], reach


def _sample_floor(image: RangeImage, place: int) -> tuple[FloatArray | IntArray, ...]:
    """Return the fields of ``Samples`` for blocks of readings near the floor, each as one reading.

    Under a lidar that turns about the vertical lines are so close that no surfel has a normal.
    """
    # Find the readings near the floor, in the frame of the axis
    n, m = (size // FLOOR_BLOCK * FLOOR_BLOCK for size in image.ranges.shape)
    axis = np.eye(4) if image.T_scan_axis is None else image.T_scan_axis
    local = replace(image, T_scan_axis=None).points[:n, :m]
    heights = local @ axis[2, :3] + axis[2, 3]
    with np.errstate(invalid="ignore"):
        near = (np.abs(heights) < FLOOR_BAND) & (image.ranges[:n, :m] > MIN_RANGE)

    # Average those of each block
    count = _sum_blocks(near)
    full = count > FLOOR_BLOCK**2 / 2
    points = _sum_blocks(np.where(near[..., None], local, 0.0))[full] / count[full, None]
    headings = _sum_blocks(np.where(near, image.yaws[:n, :m], 0.0))[full] / count[full]
    beams, ranges = _find_beams(image, points, headings)

    # Weight them as on a plane
    up = axis[2, :3]
    steep = _rotate(beams @ image.T_base_lidar[:3, :3].T, headings) @ up
    variance = (READING_SIGMA * steep) ** 2 / count[full]
    return (
        beams,
        ranges,
        headings,
        np.full(len(ranges), measure_turn_rate(image)),
        1.0 / (variance + PLANE_SIGMA**2),
        np.broadcast_to(up, beams.shape),
        np.full(len(ranges), place),
    )


def _sum_blocks(values: FloatArray | BoolArray) -> FloatArray:
    """Return the sums (n / k, m / k, ...) of ``values`` (n, m, ...) over blocks of k by k."""
    k = FLOOR_BLOCK
    n, m = values.shape[0] // k, values.shape[1] // k
    return np.asarray(values.reshape(n, k, m, k, *values.shape[2:]).sum(axis=(1, 3)), dtype=float)


def _rotate(vectors: FloatArray, yaws: FloatArray) -> FloatArray:
    """Return ``vectors`` (..., 3), rotated about z by ``yaws`` (...) [rad]."""
    return _turn(vectors, (np.cos(yaws), np.sin(yaws)))


def _turn(vectors: FloatArray, by: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return ``vectors`` (..., 3), rotated about z by angles of cosine and sine (...)."""
    (c, s), x, y = by, vectors[..., 0], vectors[..., 1]
    turned = np.empty(vectors.shape)
    turned[..., 0], turned[..., 1], turned[..., 2] = c * x - s * y, s * x + c * y, vectors[..., 2]
    return turned


def estimate_yaw_scale(places: Sequence[Sequence[RangeImage]]) -> float:
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
