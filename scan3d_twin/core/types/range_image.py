"""A sweep: the range image, and the sweep as it came from the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.compression import compress_fields, compressible
from scan3d_twin.core.types.arrays import BoolArray, FloatArray, IntArray
from scan3d_twin.core.types.pose import Pose2
from scan3d_twin.core.types.readings import LidarSpec

ROUNDING = 1e-6
"""Far less than any lidar resolves, far more than rounding [m]."""


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

    def ranges_within(self, limit: float) -> BoolArray:
        """Return which readings (n_lines, n_beams) are at most ``limit`` [m] away.

        Most lidars read whole millimetres: rounding does not decide on what reads the limit itself.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(self.ranges <= limit + ROUNDING)

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
