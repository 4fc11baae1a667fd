"""Readings of a 2D scanner on a turning axis, cut into sweeps and arranged as range images.

A reading is a range along a beam at an angle in the scan plane, taken while the axis stood at an
angle of its own. A sweep is a stretch of lines in which the axis turns on in one direction; lines
measured while it stands are left out but for the first. It ends where the axis turns back, jumps,
has turned all round, or where the lines pause.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

MIN_LINES, MIN_TURN = 20, math.radians(10.0)
"""Least lines and angle of a sweep: fewer show too little surface to be registered [rad]."""
BACKLASH = math.radians(1.0)
"""Angle by which the axis may seem to turn back within a sweep, by noise and play [rad]."""
JUMP, JUMP_STEPS = math.radians(20.0), 20.0
"""Step of the axis from one line to the next that begins another sweep: above both this angle [rad]
and so many usual steps."""
PAUSE, PAUSE_PERIODS = 2.0, 50.0
"""Time without lines that begins another sweep: above both this [s] and so many usual periods."""
MAX_MOVE = 0.02
"""Distance by which the axis may move within a sweep [m]: a robot that turns on the spot moves by
less."""
STANDSTILL = 0.1
"""Step of the axis, in usual steps, below which it stands."""
MAX_RANGE = 1000.0
"""Longest range that is believed [m]: beyond it the unit is wrong."""
MAX_READINGS = 20_000_000
"""Largest number of readings of a file: twelve full turns in steps of 0.2 deg."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings one after another, as they were taken.

    Attributes:
        origin: Where they come from, for messages: a file, a sweep in it.
        lines: Number of each reading's line (n,), ascending.
        times: When each was taken (n,) [s]; None where that is not known.
        axis: Angle of the turning axis about its direction (n,) [rad].
        angles: Angle of the beam in the scan plane (n,) [rad].
        ranges: Distances (n,) [m]; NaN where there is no return.
        min_range: Shortest distance that the lidar reports [m]; 0 where that is not known.
        max_range: Longest distance that it reports [m]; NaN where that is not known.
        T_axis_lidar: Mount of the lidar on the axis (4, 4), its scan plane x-z; None if unknown.
        R_scan_axis: Rotation (3, 3) to the upright frame of the sweep from that of the axis, its z;
            None if unknown.
        places: Where the axis stood (n, 3) [m]; None if unknown.
    """

    origin: str
    lines: IntArray
    times: FloatArray | None
    axis: FloatArray
    angles: FloatArray
    ranges: FloatArray
    min_range: float = 0.0
    max_range: float = math.nan
    T_axis_lidar: FloatArray | None = None
    R_scan_axis: FloatArray | None = None
    places: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.ranges)

    def select(self, which: BoolArray, origin: str) -> Readings:
        """Return the readings that a mask (n,) selects."""
        return replace(
            self,
            origin=origin,
            lines=self.lines[which],
            times=None if self.times is None else self.times[which],
            axis=self.axis[which],
            angles=self.angles[which],
            ranges=self.ranges[which],
            places=None if self.places is None else self.places[which],
        )


def clean_ranges(ranges: FloatArray, origin: str) -> FloatArray:
    """Return ``ranges`` (n,) [m] with NaN where there is no return: 0, negative or not finite.

    Raises:
        FileError: None is a distance, or they cannot be metres.
    """
    with np.errstate(invalid="ignore"):
        cleaned = np.where(np.isfinite(ranges) & (ranges > 0), ranges, np.nan)
    if np.all(np.isnan(cleaned)):
        raise FileError(f"{origin}: no reading has a range")
    typical = float(np.nanmedian(cleaned))
    if typical > MAX_RANGE:
        raise FileError(
            f"{origin}: typical ranges of {typical:.0f} m; state their unit: range_mm is in mm"
        )
    cleaned[cleaned > MAX_RANGE] = np.nan
    return cleaned


def number_lines(angles: FloatArray) -> IntArray:
    """Return the line of each reading (n,) by its beam angle (n,) [rad]: a new one at each return.

    The angles run one way within a line and jump back at its end.
    """
    steps = np.diff(angles)
    forward = float(np.median(steps)) >= 0
    ends = steps < 0 if forward else steps > 0
    return np.concatenate([[0], np.cumsum(ends)])


def split_sweeps(readings: Readings) -> list[Readings]:
    """Return the sweeps of ``readings``, in order; those too small to be registered are left out.

    Raises:
        FileError: None is left.
    """
    # Describe each line by its middle reading
    starts = np.flatnonzero(np.diff(readings.lines, prepend=readings.lines[0] - 1))
    middles = (starts + np.append(starts[1:], len(readings)) - 1) // 2
    axis = np.unwrap(readings.axis[middles])
    times = None if readings.times is None else readings.times[middles]
    places = np.zeros((len(starts), 3)) if readings.places is None else readings.places[middles]

    # Keep the lines of each sweep
    own = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(readings))))
    found = []
    for kept in _find_stretches(axis, times, places):
        turned = abs(float(axis[kept[-1]] - axis[kept[0]]))
        if len(kept) >= MIN_LINES and turned >= MIN_TURN:
            mask = np.zeros(len(starts), dtype=bool)
            mask[kept] = True
            found.append(mask[own])
    if not found:
        raise FileError(
            f"{readings.origin}: no sweep from one place of {MIN_LINES} lines over "
            f"{math.degrees(MIN_TURN):g} deg of the turning axis; is its angle the right column or "
            "joint?"
        )
    names = [readings.origin] if len(found) == 1 else [
        f"{readings.origin}, sweep {k}" for k in range(len(found))
    ]  # fmt: skip
    return [readings.select(mask, name) for mask, name in zip(found, names, strict=True)]


def _find_stretches(
    axis: FloatArray, times: FloatArray | None, places: FloatArray
) -> Iterator[list[int]]:
    """Yield the lines (k,) of each sweep.

    Args:
        axis: Angle of the axis at each line (n,) [rad].
        times: Time of each line (n,) [s]; None if unknown.
        places: Where the axis stood (n, 3) [m].
    """
    # Measure the usual step and the longest pause
    steps = np.abs(np.diff(axis))
    turning = steps[steps > 0]
    usual = float(np.median(turning)) if len(turning) else 0.0
    jump, back = max(JUMP, JUMP_STEPS * usual), max(BACKLASH, 3 * usual)
    pauses = np.zeros(len(axis), dtype=bool)
    if times is not None and len(times) > 1:
        apart = np.diff(times)
        limit = max(PAUSE, PAUSE_PERIODS * float(np.median(np.abs(apart))))
        pauses[1:] = (apart > limit) | (apart < 0)

    # Follow the axis from line to line
    kept, direction = [0], 0.0
    for k in range(1, len(axis)):
        ahead = float(axis[k] - axis[kept[-1]])
        onward = direction * ahead if direction else abs(ahead)
        too_far = abs(float(axis[k] - axis[kept[0]])) > math.tau + back
        too_far |= math.dist(places[k], places[kept[0]]) > MAX_MOVE
        if pauses[k] or abs(ahead) > jump or onward < -back or too_far:
            yield kept
            kept, direction = [k], 0.0
        elif onward > STANDSTILL * usual:
            direction = direction or math.copysign(1.0, ahead)
            kept.append(k)
    yield kept
