"""The value types of the package: frozen dataclasses in SI units and radians.

Frames are ``world, odom, base, lidar, scan, target, source``; ``T_a_b`` maps coordinates in b to
coordinates in a. The origin of ``base`` is on the floor below the middle of the axle, x ahead, y
left, z up. Each sweep has a frame ``scan``: its origin is where the robot stood, x points along the
middle of the sweep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.compression import (
    CompressedArray,
    compress_fields,
    compressible,
    is_compressed,
)
from scan3d_twin.core.options import renamed

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
SmallIntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]

VALID = -1
"""Entry of a ``codes`` array where the reading is a distance, not an error code."""
MIXED = -2
"""Entry of a ``codes`` array where the reading was removed as a mixed pixel."""
UNMEASURED = -3
"""Entry of a ``codes`` array where the line had no beam, or its reading is unknown."""
LOST = -4
"""Entry of a ``codes`` array of a scan line where the reading was lost on its way from the sensor:
another pass may still get it. In a range image it is ``UNMEASURED``."""


def wrap(angle: float) -> float:
    """Return ``angle`` [rad] wrapped to [-pi, pi); angles in that range keep their exact value."""
    if -math.pi <= angle < math.pi:
        return angle
    return (angle + math.pi) % math.tau - math.pi


def rms(vectors: FloatArray) -> float:
    """Return the root mean square length of ``vectors`` (n, k); 0 for none."""
    return float(np.sqrt(np.sum(vectors**2) / max(1, len(vectors))))


def read_only(array: npt.ArrayLike, dtype: Any = np.float64) -> npt.NDArray[Any]:
    """Return ``array`` as a contiguous, read-only array; writable input is copied."""
    result = np.ascontiguousarray(array, dtype=dtype)
    if result.flags.writeable:
        result = result.copy()
        result.flags.writeable = False
    return result


@dataclass(frozen=True, slots=True)
class Pose2:
    """Planar pose ``T_a_b``: position of b's origin in a and b's heading.

    Attributes:
        x: Position along a's x axis [m].
        y: Position along a's y axis [m].
        yaw: Heading, counter-clockwise positive, in [-pi, pi) [rad].

    >>> T_a_b, T_b_c = s3d.Pose2(1.0, 0.0, math.pi / 2), s3d.Pose2(0.5, 0.0, 0.0)
    >>> T_a_c = T_a_b @ T_b_c
    >>> round(T_a_c.x, 9), round(T_a_c.y, 9)
    (1.0, 0.5)
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", float(self.x))
        object.__setattr__(self, "y", float(self.y))
        object.__setattr__(self, "yaw", wrap(float(self.yaw)))

    def __matmul__(self, other: Pose2) -> Pose2:
        """Return ``T_a_c`` from ``T_a_b @ T_b_c``."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            self.yaw + other.yaw,
        )

    def inverse(self) -> Pose2:
        """Return ``T_b_a``."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def apply(self, points: FloatArray) -> FloatArray:
        """Return ``points`` (..., 2 or 3) [m], mapped from b to a; z is kept."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = points[..., 0], points[..., 1]
        result = np.array(points, dtype=np.float64)
        np.subtract(self.x + c * x, s * y, out=result[..., 0])
        np.add(self.y + s * x, c * y, out=result[..., 1])
        return result

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Return the directions ``vectors`` (..., 2 or 3), rotated from b to a."""
        return Pose2(0.0, 0.0, self.yaw).apply(vectors)

    def matrix(self) -> FloatArray:
        """Return the homogeneous transform (4, 4)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array(
            [[c, -s, 0.0, self.x], [s, c, 0.0, self.y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        )

    @staticmethod
    def from_matrix(T: FloatArray) -> Pose2:
        """Return the planar part (x, y, yaw) of a homogeneous transform (4, 4)."""
        return Pose2(float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0]))

    def distance(self, other: Pose2) -> float:
        """Return the distance between the two origins [m]."""
        return math.hypot(self.x - other.x, self.y - other.y)


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """Geometry and timing of a scan line.

    A line may have elevations and times of its own, beam j near those stated here.

    Attributes:
        elevations: Beam angle in the vertical scan plane (n_beams,) [rad]; 0 ahead, positive up.
        beam_times: Time of each beam after the line's stamp (n_beams,) [s].
        line_period: Time between two lines, nominally [s].
        min_range: Shortest distance that the lidar reports [m].
        max_range: Longest distance that is trusted [m].
    """

    elevations: FloatArray
    beam_times: FloatArray
    line_period: float
    min_range: float
    max_range: float

    @property
    def n_beams(self) -> int:
        """Number of beams in a line."""
        return len(self.elevations)


@dataclass(frozen=True, slots=True)
class ScanLine:
    """One revolution of the lidar.

    Attributes:
        stamp: Time of step 0 of the revolution on ``Clock.now()`` [s].
        ranges: Distances (n_beams,) [m]; NaN where there is no valid return.
        codes: The sensor's error codes (n_beams,); ``VALID`` where ``ranges`` is a distance.
        elevations: Beam angles of this line (n_beams,) [rad]; None if they are those of the
            ``LidarSpec``. ``arrange_line`` makes lines of beams at any angles.
        beam_times: Times of its beams after the stamp (n_beams,) [s]; None as for ``elevations``.
    """

    stamp: float
    ranges: FloatArray
    codes: IntArray
    elevations: FloatArray | None = None
    beam_times: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Beams:
    """Readings one after another, as a lidar that turns all round takes them.

    Attributes:
        times: When each was measured, on ``Clock.now()``, ascending (n,) [s].
        elevations: Beam angles, as in ``LidarSpec``, in [-pi, pi) (n,) [rad].
        ranges: Distances (n,) [m]; NaN where there is no valid return.
        codes: Error codes (n,), ``VALID`` where ``ranges`` is a distance.
    """

    times: FloatArray
    elevations: FloatArray
    ranges: FloatArray
    codes: IntArray

    def __len__(self) -> int:
        return len(self.times)

    def select(self, which: Any) -> Beams:
        """Return the beams at an index, a slice or a mask, in their order."""
        return Beams(
            self.times[which], self.elevations[which], self.ranges[which], self.codes[which]
        )

    @staticmethod
    def join(parts: Sequence[Beams]) -> Beams:
        """Return ``parts`` one after another; no beams if there are none."""
        if not parts:
            return Beams(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int64))
        return Beams(
            np.concatenate([part.times for part in parts]),
            np.concatenate([part.elevations for part in parts]),
            np.concatenate([part.ranges for part in parts]),
            np.concatenate([part.codes for part in parts]),
        )


@dataclass(frozen=True, slots=True)
class Odometry:
    """Pose of the base by dead reckoning.

    Attributes:
        stamp: Time on ``Clock.now()`` [s].
        T_odom_base: Pose in the frame in which the robot was opened.
        covariance: Covariance of x, y [m] and yaw [rad] since opening (3, 3).
    """

    stamp: float
    T_odom_base: Pose2
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class TableAngle:
    """Angle of a turntable by its own sensor.

    Attributes:
        stamp: Time on ``Clock.now()`` [s].
        angle: About the turning axis, 0 in the middle [rad]. The play of its gear stands between
            it and the angle of what it carries.
    """

    stamp: float
    angle: float


@dataclass(frozen=True, slots=True)
class Hazards:
    """The conditions that stop the robot; all False with a charged battery is safe.

    Attributes:
        battery: State of charge, 0..1.
    """

    bump_left: bool = False
    bump_right: bool = False
    cliff_left: bool = False
    cliff_front_left: bool = False
    cliff_front_right: bool = False
    cliff_right: bool = False
    wheel_drop_left: bool = False
    wheel_drop_right: bool = False
    overcurrent_left: bool = False
    overcurrent_right: bool = False
    battery: float = 1.0

    def active(self) -> tuple[str, ...]:
        """Return the active hazards in words."""
        flags = (name for name in self.__slots__ if name != "battery")
        return tuple(name.replace("_", " ") for name in flags if getattr(self, name))


@compressible("yaws", "ranges", "codes", "elevations")
@dataclass(frozen=True, eq=False)
class RangeImage:
    """One sweep, the paper's P = {l_1 .. l_n}: ranges by line and beam, in frame ``scan``.

    Lines are ordered left to right as the robot sees them (falling yaw), in whichever direction it
    turned.

    Attributes:
        stamps: Time of each line (n_lines,) [s].
        yaws: Heading of the base when each beam was measured, in ``scan``, or the angle of the
            turntable about its axis (n_lines, n_beams) [rad].
        ranges: Distances, NaN where there is no valid return (n_lines, n_beams) [m].
        codes: Error codes, ``VALID`` where measured; a filled gap keeps its code (n_lines,
            n_beams).
        spec: The lidar's geometry.
        T_base_lidar: Extrinsics of the lidar in what is turned: the base, or the frame ``axis`` of
            a turntable (4, 4).
        elevations: Elevation of each reading (n_lines, n_beams) [rad], beam j near that of
            ``spec``; None where all lines have those of ``spec``.
        T_scan_axis: Pose of the turntable's axis, its z, in ``scan`` (4, 4); None where the base
            turned. A point is ``T_scan_axis Rz(yaw) T_base_lidar beam``.
        noise: Noise along and across the lines that were measured, where those of the image are
            others: range sigma at 0 m [m], its growth per metre, sigma of a line's yaw [rad],
            factor for correlated beams (4,), NaN to be estimated; None if all is.

    >>> image = session.views[0].observation.image
    >>> image.ranges.shape == image.yaws.shape == image.points.shape[:2]
    True
    """

    stamps: FloatArray
    yaws: FloatArray
    ranges: FloatArray
    codes: IntArray
    spec: LidarSpec
    T_base_lidar: FloatArray
    elevations: FloatArray | None = None
    T_scan_axis: FloatArray | None = None
    noise: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.elevations is not None and np.array_equal(
            self.elevations, np.broadcast_to(self.spec.elevations, self.yaws.shape)
        ):
            object.__setattr__(self, "elevations", None)

    @property
    def n_lines(self) -> int:
        """Number of scan lines."""
        return len(self.stamps)

    def compress(self, *others: RangeImage) -> None:
        """Compress the large arrays of this image and ``others``, which are seldom read."""
        compress_fields(("yaws", "ranges", "codes", "elevations"), self, *others)

    @property
    def elevation_rows(self) -> FloatArray:
        """Elevations of the readings [rad]: (n_lines, n_beams), or (1, n_beams) if lines agree."""
        own = self.elevations
        return self.spec.elevations[None] if own is None else own

    def elevations_at(self, lines: IntArray, beams: IntArray) -> FloatArray:
        """Return the elevations of some readings (n,) [rad], by lines (n,) and beams (n,)."""
        own = self.elevations
        return self.spec.elevations[beams] if own is None else own[lines, beams]

    @property
    def directions(self) -> FloatArray:
        """Beam directions in ``scan`` (n_lines, n_beams, 3); computed anew each time."""
        yaws = self.yaws
        turned = np.stack(_rotated(self.beams, np.cos(yaws), np.sin(yaws)), axis=-1)
        return self._rotated_to_scan(turned)

    @property
    def points(self) -> FloatArray:
        """Measured points in ``scan`` (n_lines, n_beams, 3) [m]; NaN where there is no return.

        Computed anew each time: a session keeps its images, and points take six times their memory.
        """
        return self._placed(self.ranges, self.beams, self.yaws)

    @property
    def heights(self) -> FloatArray:
        """Heights of the ``points`` (n_lines, n_beams) [m]; turns of the base change none."""
        if self._axis is not None:
            return np.asarray(self.points[..., 2])
        return np.asarray(self.T_base_lidar[2, 3] + self.ranges * self.beams[..., 2])

    def points_at(self, lines: IntArray, beams: IntArray) -> FloatArray:
        """Return the ``points`` of some readings (n, 3) [m], by their lines (n,) and beams (n,)."""
        yaws, ranges = self.yaws[lines, beams], self.ranges[lines, beams]
        return self._placed(ranges, self._beams_at(lines, beams), yaws)

    def directions_at(self, lines: IntArray, beams: IntArray) -> FloatArray:
        """Return the ``directions`` of some readings (n, 3), by their lines (n,) and beams (n,)."""
        yaws = self.yaws[lines, beams]
        turned = _rotated(self._beams_at(lines, beams), np.cos(yaws), np.sin(yaws))
        return self._rotated_to_scan(np.stack(turned, axis=-1))

    @property
    def _axis(self) -> FloatArray | None:
        """``T_scan_axis``, or None where it changes nothing."""
        T = self.T_scan_axis
        return None if T is None or np.array_equal(T, np.eye(4)) else T

    def _rotated_to_scan(self, vectors: FloatArray) -> FloatArray:
        """Return directions (..., 3), rotated from ``axis`` to ``scan``."""
        T = self._axis
        return vectors if T is None else np.asarray(vectors @ T[:3, :3].T)

    def _placed(self, ranges: FloatArray, beams: FloatArray, yaws: FloatArray) -> FloatArray:
        """Return points (..., 3) at ``ranges`` along ``beams`` (..., 3), the base at ``yaws``."""
        c, s = np.cos(yaws), np.sin(yaws)
        result = np.empty((*yaws.shape, 3))
        levers, turned = _rotated(self.T_base_lidar[:3, 3], c, s), _rotated(beams, c, s)
        for i, (lever, beam) in enumerate(zip(levers, turned, strict=True)):
            np.add(lever, ranges * beam, out=result[..., i])
        T = self._axis
        return result if T is None else self._rotated_to_scan(result) + T[:3, 3]

    @property
    def beams(self) -> FloatArray:
        """Beam directions in what turns: (n_lines, n_beams, 3), or (n_beams, 3) if lines agree."""
        own = self.elevations
        return self._directions_in_base(self.spec.elevations if own is None else own)

    def _beams_at(self, lines: IntArray, beams: IntArray) -> FloatArray:
        """Return the ``beams`` of some readings (n, 3), by their lines (n,) and beams (n,)."""
        if self.elevations is None:
            return np.asarray(self.beams[beams])
        return self._directions_in_base(self.elevations_at(lines, beams))

    def _directions_in_base(self, e: FloatArray) -> FloatArray:
        """Return the directions (..., 3) in ``base`` of beams at the elevations ``e`` (...)."""
        beams = np.stack([np.cos(e), np.zeros_like(e), np.sin(e)], axis=-1)
        return np.asarray(beams @ self.T_base_lidar[:3, :3].T)


def _rotated(
    vectors: FloatArray, c: FloatArray, s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x, y and z of ``vectors`` (..., 3) after turns about z by angles of c and s (...)."""
    x, y, z = vectors[..., 0], vectors[..., 1], np.broadcast_to(vectors[..., 2], c.shape)
    return c * x - s * y, s * x + c * y, z


@dataclass(frozen=True, slots=True)
class Observation:
    """One sweep as it came from the robot.

    Attributes:
        image: The raw range image in frame ``scan``.
        T_odom_scan: Pose of the sweep by odometry; the identity where there is none.
        touched: Places (x, y) in ``odom`` [m] where the robot bumped into something on the way.
        legs: How the wheels moved since the sweep before it: turn on the spot [rad], not wrapped,
            and length of the drive after it [m], again and again; empty where it is not known.
        has_odometry: Whether ``T_odom_scan`` was measured; False for a scanner set down by hand.
    """

    image: RangeImage
    T_odom_scan: Pose2
    touched: tuple[tuple[float, float], ...] = ()
    legs: tuple[tuple[float, float], ...] = ()
    has_odometry: bool = True

    def moved(self, T_odom_old: Pose2) -> Observation:
        """Return the same sweep in another ``odom``, in which the old one has the given pose."""
        touched = T_odom_old.apply(np.array(self.touched).reshape(-1, 2)).tolist()
        return replace(
            self,
            T_odom_scan=T_odom_old @ self.T_odom_scan,
            touched=tuple((x, y) for x, y in touched),
        )


@compressible("points", "lines", "beams")
@dataclass(frozen=True, eq=False)
class Scan3D:
    """Points of one sweep in frame ``scan``, sorted by line, left to right.

    Attributes:
        points: (n, 3) [m].
        lines: Index of each point's line in its range image (n,), ascending.
        beams: Index of each point's beam (n,).
        n_lines: Number of lines of that range image.

    >>> scan = session.views[0].target
    >>> scan.points.shape == (len(scan), 3)
    True
    >>> len(scan.last_lines(10).occupied_lines)  # the paper's Q for n_Q = 10
    10
    """

    points: FloatArray
    lines: IntArray
    beams: IntArray
    n_lines: int

    def __len__(self) -> int:
        return len(self.points)

    def compress(self, image: RangeImage) -> None:
        """Compress the arrays, which are seldom read.

        Points that equal those of ``image`` are computed from it from then on.
        """
        if is_compressed(self, "points"):
            return
        lines, beams = CompressedArray.of(self.lines), CompressedArray.of(self.beams)
        placed = _PointsOf(image, lines, beams)
        if np.array_equal(placed.decompress(), self.points):
            for name, compressed in (("points", placed), ("lines", lines), ("beams", beams)):
                object.__setattr__(self, name, compressed)

    @cached_property
    def occupied_lines(self) -> IntArray:
        """Indices of the lines that hold at least one point, ascending: the paper's l_1 .. l_n."""
        return np.flatnonzero(np.bincount(self.lines))

    def with_points_of(self, image: RangeImage) -> Scan3D:
        """Return the scan with its points taken from another ``image`` of the same sweep."""
        lines, beams = self.lines, self.beams
        return Scan3D(image.points_at(lines, beams), lines, beams, self.n_lines)

    def select(self, mask: BoolArray) -> Scan3D:
        """Return the points where ``mask`` (n,) is True."""
        kept = np.flatnonzero(mask)
        points = self.points.take(kept, axis=0)
        return Scan3D(points, self.lines.take(kept), self.beams.take(kept), self.n_lines)

    def first_lines(self, k: int) -> Scan3D:
        """Return the points of the first ``k`` occupied lines."""
        return self._lines_from(0, k)

    def middle_lines(self, k: int) -> Scan3D:
        """Return the points of the middle ``k`` occupied lines: Q' of eq. (5) when called on Q."""
        first = max(0, len(self.occupied_lines) - k) // 2
        return self._lines_from(first, k)

    def last_lines(self, k: int) -> Scan3D:
        """Return the points of the last ``k`` occupied lines: the paper's Q for k = n_Q."""
        first = max(0, len(self.occupied_lines) - k)
        return self._lines_from(first, k)

    def _lines_from(self, first: int, k: int) -> Scan3D:
        """Return the points of ``k`` occupied lines from the ``first`` one."""
        wanted = self.occupied_lines[first : first + k]
        if len(wanted) == 0:
            return self.select(np.zeros(len(self), dtype=bool))
        return self.select((self.lines >= wanted[0]) & (self.lines <= wanted[-1]))


@dataclass(frozen=True, slots=True)
class _PointsOf:
    """The points of an image at ``lines`` and ``beams``."""

    image: RangeImage
    lines: CompressedArray
    beams: CompressedArray

    def decompress(self) -> FloatArray:
        """Return the points (n, 3) [m], read-only."""
        points = self.image.points_at(self.lines.decompress(), self.beams.decompress())
        points.flags.writeable = False
        return points


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """The pose of a source scan in a target scan, and its uncertainty.

    Attributes:
        T_target_source: The pose (4, 4).
        covariance: Covariance of x, y, z [m] and rx, ry, rz [rad] about the target's origin (6, 6);
            without a prior infinite where an undetermined direction points.
        information: Information matrix (6, 6): the inverse of the covariance on the estimated
            directions, 0 on the others.
        fitness: Share of source points with a correspondence, 0..1.
        inlier_rmse: Root mean square distance of the correspondences [m].
        predicted_rmse: Expected root mean square displacement of the source points [m].
        num_inliers: Number of correspondences.
        iterations: Iterations run.
        converged: Whether the result may be used.
        degenerate_directions: Unit directions (k, 6) that the data do not determine.
        ambiguity_gap: Score distance to the next best basin, 0..1, 1 if several starts met in one;
            NaN where a single start looked for no other.

    >>> result = session.views[1].registration
    >>> result.converged, result.covariance.shape, bool(result.predicted_rmse < 0.01)
    (True, (6, 6), True)
    """

    T_target_source: FloatArray
    covariance: FloatArray
    information: FloatArray
    fitness: float
    inlier_rmse: float
    predicted_rmse: float
    num_inliers: int
    iterations: int
    converged: bool
    degenerate_directions: FloatArray
    ambiguity_gap: float

    @staticmethod
    def unregistered(
        T: FloatArray, covariance: FloatArray, information: FloatArray
    ) -> RegistrationResult:
        """Return the result for scans that cannot be registered: the initial guess as it was.

        Args:
            T: The initial guess (4, 4).
            covariance: Its covariance (6, 6).
            information: Its information matrix (6, 6).
        """
        return RegistrationResult(
            T_target_source=T,
            covariance=covariance,
            information=information,
            fitness=0.0,
            inlier_rmse=math.nan,
            predicted_rmse=math.nan,
            num_inliers=0,
            iterations=0,
            converged=False,
            degenerate_directions=read_only(np.zeros((0, 6))),
            ambiguity_gap=math.nan,
        )


@dataclass(frozen=True, slots=True)
class Candidate:
    """One viewpoint that a planner considered.

    Attributes:
        viewpoint: ``T_world_scan`` of the sweep that would be taken there.
        overlap: The paper's eta: share of the current target lines that are seen again.
        predicted_rmse: Predicted registration error E [m]; NaN where it was not predicted.
        feasible: Whether the robot can reach it and stand there.
    """

    viewpoint: Pose2
    overlap: float
    predicted_rmse: float
    feasible: bool


@dataclass(frozen=True, slots=True)
class Plan:
    """The decision of a planner and its reason.

    Attributes:
        viewpoint: ``T_world_scan`` of the next sweep; None when the scan is finished.
        overlap: The chosen eta; 0 when finished.
        predicted_rmse: E of the chosen overlap [m]; NaN when unknown.
        fell_back: Whether no viewpoint met epsilon, so that the one nearest to it was taken.
        candidates: All viewpoints that were considered, in that order.
        reason: Why the planner decided so, in words.
        needs_panorama: Whether a panorama from here may show that a better viewpoint is free.
        half_width: Half the angle of the sweep there [rad]; None for all of it.

    >>> plan = session.plans[0]
    >>> plan.viewpoint is not None, 0.0 < plan.overlap < 1.0
    (True, True)
    """

    viewpoint: Pose2 | None
    overlap: float
    predicted_rmse: float
    fell_back: bool
    candidates: tuple[Candidate, ...]
    reason: str
    needs_panorama: bool = renamed(False, "needs_look")
    half_width: float | None = None
