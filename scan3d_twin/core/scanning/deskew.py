"""De-skewing: every beam gets the heading that the base had when that beam was measured.

The base turns on while the mirror of the lidar turns, so that a line is not a plane. Odometry is
interpolated at the time of each beam, or the samples of the turntable that turns the lidar.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.hal import Robot, Turntable
from scan3d_twin.core.types import FloatArray, LidarSpec, ScanLine, wrap

MAX_ODOMETRY_GAP = 10
"""Sample periods without odometry after which the heading is unknown: lines in the gap are lost."""

Lines = list[tuple[ScanLine, FloatArray]]
"""Lines with each beam's heading relative to the middle of the sweep (n_beams,) [rad]."""


def deskew_lines(
    robot: Robot, lines: list[ScanLine], started: float, yaw: float, first: float
) -> Lines:
    """Return ``lines`` with the heading of each beam; without those in gaps of the odometry.

    Args:
        robot: Its odometry gives the headings, its lidar the beams' times.
        lines: As they were read, in order.
        started: When the turn began, on the robot's clock [s].
        yaw: Heading in ``odom`` of the middle of the sweep, to which headings are relative [rad].
        first: Relative heading near which the turn began; it settles the number of turns [rad].
    """
    # Unwrap the headings of the turn
    odometry = robot.base.odometry_since(started)
    stamps = np.array([sample.stamp for sample in odometry])
    headings = np.unwrap([sample.T_odom_base.yaw for sample in odometry])
    headings += first + wrap(float(headings[0]) - yaw - first) - headings[0]

    return _interpolate(robot, lines, (stamps, headings), robot.base.spec.sample_period)


def deskew_table_lines(
    robot: Robot, table: Turntable, lines: list[ScanLine], started: float, lag: float
) -> Lines:
    """Return ``lines`` with the angle of a turntable at each beam; without those in gaps of it.

    Args:
        robot: Its lidar gives the beams' times.
        table: Its samples give the angles.
        lines: As they were read, in order.
        started: When the turn began, on the robot's clock [s].
        lag: Angle by which what is carried is ahead of the angle sensor [rad].
    """
    samples = table.angles_since(started)
    stamps = np.array([sample.stamp for sample in samples])
    angles = np.array([sample.angle for sample in samples]) + lag
    return _interpolate(robot, lines, (stamps, angles), table.spec.sample_period)


def _interpolate(
    robot: Robot, lines: list[ScanLine], samples: tuple[FloatArray, FloatArray], period: float
) -> Lines:
    """Return ``lines`` with the angle of each beam, without those in gaps of the ``samples``.

    Args:
        robot: Its lidar gives the beams' times.
        lines: As they were read.
        samples: Stamps (n,) [s] and angles (n,) [rad] of what turned.
        period: Nominal time between two samples [s].
    """
    if not lines:
        return []

    # Interpolate outside of gaps
    stamps, headings = samples
    times = np.array([line.stamp + _find_beam_times(line, robot.lidar.spec) for line in lines])
    first_times, last_times = (end(times, axis=1, keepdims=True) for end in (np.min, np.max))
    gaps = np.flatnonzero(np.diff(stamps) > MAX_ODOMETRY_GAP * period)
    after, before = first_times < stamps[gaps + 1], last_times > stamps[gaps]
    whole = ~np.any(after & before, axis=1)
    yaws = np.interp(times, stamps, headings)
    return [pair for pair, kept in zip(zip(lines, yaws, strict=True), whole, strict=True) if kept]


def _find_beam_times(line: ScanLine, spec: LidarSpec) -> FloatArray:
    """Return the times of the beams of ``line`` after its stamp (n_beams,) [s]."""
    return spec.beam_times if line.beam_times is None else line.beam_times
