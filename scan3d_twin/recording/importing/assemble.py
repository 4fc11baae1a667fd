"""Range images of sweeps that were imported, on one mount of the lidar.

With the axis up, a reading at beam angle e, range r and axis angle psi is the point

    Rz(psi) T_axis_lidar (r cos e, 0, r sin e).

Each reading keeps the angle at which it was taken, so that sweeps are de-skewed by the file's own
angles. Frame ``scan`` is the axis at the middle angle of the sweep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.hal import default_mount
from scan3d_twin.core.line_grid import arrange_line
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
DEFAULT_PERIOD = 0.1
"""Period of the lines where the file tells no times [s]."""
SAME_ANGLE = 1e-4
"""Difference of two beam angles that are the same [rad]."""


@dataclass(frozen=True)
class Mount:
    """Where the lidar is on the turning axis; None is unknown.

    Attributes:
        place: x ahead, y left, z up [m], from the axis and the floor.
        angles: yaw, pitch and roll [rad] of the scan plane, which is x-z at 0.
    """

    place: tuple[float, float, float] | None = None
    angles: tuple[float, float, float] | None = None

    @staticmethod
    def parse(text: str) -> Mount:
        """Return the mount that ``text`` states: x,y,z [m] or x,y,z,yaw,pitch,roll [m, deg].

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
        yaw, pitch, roll = (math.radians(angle) for angle in angles or (0.0, 0.0, 0.0))
        return Mount((x, y, z), (yaw, pitch, roll))

    def matrix(self, known: FloatArray | None) -> FloatArray:
        """Return ``T_axis_lidar`` (4, 4): as stated, else as the file has it, else upright."""
        T = np.eye(4) if known is None else known.copy()
        if self.angles is not None:
            T[:3, :3] = Rotation.from_euler("ZYX", self.angles).as_matrix()
        if self.place is not None:
            T[:3, 3] = self.place
        return T


def assemble(readings: Readings, mount: Mount) -> RangeImage:
    """Return the range image of one sweep.

    Raises:
        FileError: Its lines have no angle in common, or the mount sweeps nothing.
    """
    # Check that the plane sweeps a volume
    T = mount.matrix(readings.T_axis_lidar)
    if abs(T[2, 1]) > math.cos(math.pi / 2 - MAX_LEAN):
        raise FileError(
            f"{readings.origin}: the scan plane lies across the turning axis and sweeps nothing; "
            "state how the lidar is mounted with --mount, or what turns with --axis"
        )

    # Cut it into lines, sorted left to right
    starts = np.flatnonzero(np.diff(readings.lines, prepend=readings.lines[0] - 1))
    parts = [slice(a, b) for a, b in zip(starts, [*starts[1:], len(readings)], strict=True)]
    axis = np.unwrap(readings.axis)
    axis -= (float(axis[parts[0]].mean()) + float(axis[parts[-1]].mean())) / 2
    if axis[0] < axis[-1]:
        parts.reverse()

    # Arrange the lines on one grid
    angles = (readings.angles + math.pi) % math.tau - math.pi
    times = _find_times(readings)
    spec = _make_spec(readings, angles, times, parts)
    lines = [_arrange(spec, readings, angles, axis, times, part) for part in parts]
    elevations = np.array([own for *_, own in lines])
    return RangeImage(
        stamps=read_only([stamp for stamp, *_ in lines]),
        yaws=read_only([yaws for _, yaws, *_ in lines]),
        ranges=read_only([ranges for _, _, ranges, *_ in lines]),
        codes=read_only([codes for _, _, _, codes, _ in lines], np.int64),
        spec=spec,
        T_base_lidar=read_only(T),
        elevations=read_only(elevations),
    )


def estimate_height(images: Sequence[RangeImage]) -> float | None:
    """Return how high the lidar is above the floor [m], by the lowest points of all ``images``.

    None where no beam looks down far enough.
    """
    heights, looks_down = [], False
    for image in images:
        down = np.isfinite(image.ranges) & (image.beams[..., 2] < math.sin(LOWEST_ELEVATION))
        looks_down = looks_down or bool(np.any(down))
        heights.append(image.heights[np.isfinite(image.ranges)] - image.T_base_lidar[2, 3])
    if not looks_down:
        return None
    every = np.concatenate(heights)
    lowest = float(np.percentile(every, LOWEST_SHARE))
    return -float(np.median(every[np.abs(every - lowest) < FLOOR_BAND]))


def default_height() -> float:
    """Return the height of the lidar of our own robot [m]."""
    return float(default_mount()[2, 3])


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
