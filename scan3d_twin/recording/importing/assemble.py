"""Range images of sweeps that were imported, on one mount of the lidar.

A reading at beam angle e, range r and axis angle psi is the point

    T_scan_axis Rz(psi) T_axis_lidar (r cos e, 0, r sin e),

with the z of the frame ``axis`` up for yaw, to the left for pitch and ahead for roll. Each reading
keeps the angle at which it was taken, so that sweeps are de-skewed by the file's own angles. About
an upright axis, frame ``scan`` is the axis at the middle angle of the sweep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.scanning.patterns import find_axis_mount, find_mount
from scan3d_twin.core.types import (
    UNMEASURED,
    VALID,
    FloatArray,
    IntArray,
    LidarSpec,
    RangeImage,
    read_only,
)
from scan3d_twin.recording.importing.readings import Readings

NO_RETURN = 0
"""Error code of a reading without a range."""
LOWEST_SHARE, FLOOR_BAND = 1.0, 0.03
"""Share of the points [%] below which strays may lie, and distance from there within which points
are of the floor [m]: the noise of readings and a lean of 0.5 deg at 3 m. Assumptions."""
LOWEST_ELEVATION = math.radians(-20.0)
"""Elevation that a beam must reach to see the floor, in a room of usual size [rad]."""
MAX_LEAN = math.radians(45.0)
"""Largest angle of the scan plane to the turning axis [rad]: a plane across it sweeps nothing."""
MAX_TILT = math.radians(2.0)
"""Lean of an axis up to which it is upright: what cannot be told from a floor that is not level
[rad]."""
DEFAULT_PERIOD = 0.1
"""Period of the lines where the file tells no times [s]."""
SAME_ANGLE = 1e-4
"""Difference of two beam angles that are the same [rad]."""


@dataclass(frozen=True)
class Mount:
    """Where the lidar is at the angle 0 of the axis; None is unknown.

    Attributes:
        pattern: What the axis turns: yaw, pitch or roll, where the file does not tell.
        place: x ahead, y left, z up of the axis [m].
        angles: yaw, pitch and roll [rad] of the lidar, whose scan plane is x-z.
        height: Height of the axis above the floor [m].
    """

    pattern: str = "yaw"
    place: tuple[float, float, float] | None = None
    angles: tuple[float, float, float] | None = None
    height: float | None = None

    def parse(self, text: str) -> Mount:
        """Return the mount with what ``text`` states: x,y,z [m] or x,y,z,yaw,pitch,roll [m, deg].

        Raises:
            ConfigError: It is neither.
        """
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) not in (3, 6) or not all(math.isfinite(value) for value in values):
            raise ConfigError(
                f"--mount must be x,y,z in metres, or x,y,z,yaw,pitch,roll with angles in degrees, "
                f"got {text!r}"
            )
        x, y, z, *angles = values
        if not angles:
            return replace(self, place=(x, y, z))
        yaw, pitch, roll = (math.radians(angle) for angle in angles)
        return replace(self, place=(x, y, z), angles=(yaw, pitch, roll))

    def frames(self, readings: Readings) -> tuple[FloatArray, FloatArray]:
        """Return ``T_scan_axis``, on the floor, and ``T_axis_lidar`` (4, 4): as stated, else known.

        What neither states nor file tell is as designed for the pattern, on the axis.
        """
        designed = find_mount(self.pattern)
        assert designed is not None
        T_scan_axis = np.eye(4)
        known = readings.R_scan_axis
        T_scan_axis[:3, :3] = designed.T_base_axis[:3, :3] if known is None else known

        # The lidar at the angle 0, in the upright frame
        T = np.eye(4)
        if readings.T_axis_lidar is not None:
            T = T_scan_axis @ readings.T_axis_lidar
        else:
            T[:3, :3] = designed.T_base_lidar[:3, :3]
        if self.angles is not None:
            T[:3, :3] = Rotation.from_euler("ZYX", self.angles).as_matrix()
        if self.place is not None:
            T[:3, 3] = self.place
        return T_scan_axis, find_axis_mount(T_scan_axis, T)


def assemble(readings: Readings, mount: Mount) -> RangeImage:
    """Return the range image of one sweep, its axis at the mount's height, or on the floor.

    Raises:
        FileError: Its lines have no angle in common, or the mount sweeps nothing.
    """
    # Check that the plane sweeps a volume
    T_scan_axis, T = mount.frames(readings)
    if abs(T[2, 1]) > math.cos(math.pi / 2 - MAX_LEAN):
        raise FileError(
            f"{readings.origin}: the scan plane lies across the turning axis and sweeps nothing; "
            "state how the lidar is mounted with --mount, or what turns with --axis"
        )
    upright = bool(T_scan_axis[2, 2] > math.cos(MAX_TILT))

    # Cut it into lines, sorted left to right
    starts = np.flatnonzero(np.diff(readings.lines, prepend=readings.lines[0] - 1))
    parts = [slice(a, b) for a, b in zip(starts, [*starts[1:], len(readings)], strict=True)]
    axis = np.unwrap(readings.axis)
    if upright:
        axis -= (float(axis[parts[0]].mean()) + float(axis[parts[-1]].mean())) / 2
    if axis[0] < axis[-1]:
        parts.reverse()

    # Arrange the lines on one grid
    angles = (readings.angles + math.pi) % math.tau - math.pi
    times = _find_times(readings)
    spec = _make_spec(readings, angles, times, parts)
    lines = [_arrange(spec, readings, angles, axis, times, part) for part in parts]
    elevations = np.array([own for *_, own in lines])
    image = RangeImage(
        stamps=read_only([stamp for stamp, *_ in lines]),
        yaws=read_only([yaws for _, yaws, *_ in lines]),
        ranges=read_only([ranges for _, _, ranges, *_ in lines]),
        codes=read_only([codes for _, _, _, codes, _ in lines], np.int64),
        spec=spec,
        T_base_lidar=read_only(T),
        elevations=read_only(elevations),
        T_scan_axis=None if upright else read_only(T_scan_axis),
    )
    return lift(image, mount.height or 0.0)


def lift(image: RangeImage, height: float) -> RangeImage:
    """Return ``image`` with its axis higher by ``height`` [m]."""
    tilted = image.T_scan_axis is not None
    T = np.array(image.T_scan_axis if tilted else image.T_base_lidar)
    T[2, 3] += height
    if tilted:
        return replace(image, T_scan_axis=read_only(T))
    return replace(image, T_base_lidar=read_only(T))


def estimate_height(images: Sequence[RangeImage]) -> float | None:
    """Return how high the axis is above the floor [m], by the lowest points of all ``images``.

    None where no beam looks down far enough.

    Args:
        images: Sweeps with the axis on the floor.
    """
    heights, looks_down = [], False
    for image in images:
        seen = np.isfinite(image.ranges)
        down = image.directions[..., 2] < math.sin(LOWEST_ELEVATION)
        looks_down = looks_down or bool(np.any(down & seen))
        heights.append(image.heights[seen])
    if not looks_down:
        return None
    every = np.concatenate(heights)
    lowest = float(np.percentile(every, LOWEST_SHARE, method="lower"))
    return -float(np.median(every[np.abs(every - lowest) < FLOOR_BAND]))


def _find_times(readings: Readings) -> FloatArray:
    """Return the time of each reading (n,) [s]; a line per period where it is not known."""
    if readings.times is not None:
        return np.asarray(readings.times - readings.times[0])
    return np.asarray((readings.lines - readings.lines[0]) * DEFAULT_PERIOD, dtype=np.float64)


def _make_spec(
    readings: Readings, angles: FloatArray, times: FloatArray, parts: list[slice]
) -> LidarSpec:
    """Return a grid on which each line of ``readings`` has room for its beams."""
    # Take the angles of the fullest line, or a full circle of as many
    fullest = max(parts, key=lambda part: part.stop - part.start)
    order = np.argsort(angles[fullest], kind="stable")
    elevations = angles[fullest][order]
    distinct = np.concatenate([[True], np.diff(elevations) > SAME_ANGLE])
    elevations, order = elevations[distinct], order[distinct]
    if len(elevations) < 2:
        raise FileError(f"{readings.origin}: its lines have a single beam; no scan plane")

    # Describe their times and limits
    beam_times = times[fullest][order] - times[fullest].min()
    stamps = np.sort([float(times[part].min()) for part in parts])
    longest = float(np.nanmax(readings.ranges, initial=0.0))
    known = readings.max_range if math.isfinite(readings.max_range) else longest
    return LidarSpec(
        elevations=read_only(elevations),
        beam_times=read_only(beam_times),
        line_period=max(0.0, float(np.median(np.diff(stamps)))) if len(stamps) > 1 else 0.0,
        min_range=max(0.0, readings.min_range),
        max_range=max(known, 0.1),
    )


def _arrange(
    spec: LidarSpec,
    readings: Readings,
    angles: FloatArray,
    axis: FloatArray,
    times: FloatArray,
    part: slice,
) -> tuple[float, FloatArray, FloatArray, IntArray, FloatArray]:
    """Return stamp, yaws, ranges, codes and elevations of one line on the grid of ``spec``."""
    ranges = readings.ranges[part]
    codes = np.where(np.isfinite(ranges), VALID, NO_RETURN)
    order = np.argsort(angles[part], kind="stable")
    stamp = float(times[part].min())

    # Most lines are the grid's own
    if len(order) == spec.n_beams:
        own = angles[part][order]
        if np.allclose(own, spec.elevations, atol=SAME_ANGLE, rtol=0.0):
            return stamp, axis[part][order], ranges[order], codes[order], own

    # The others are arranged on it; yaws are interpolated where there is no reading, as times are
    line = arrange_line(spec, stamp, angles[part], axis[part], ranges, codes)
    assert line.beam_times is not None
    assert line.elevations is not None
    own = np.where(line.codes == UNMEASURED, spec.elevations, line.elevations)
    return stamp, line.beam_times, line.ranges, line.codes, own
