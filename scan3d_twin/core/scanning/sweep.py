"""Sweeping: the robot turns on the spot and the vertical scan lines sweep out a range image.

Every beam gets the heading the base had when that beam was measured (de-skewing), and lines that
did not arrive are scanned again (the data-loss check of the paper's Fig. 5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import DataLossError, LinkTimeoutError
from scan3d_twin.core.hal import BunchingLidar, Robot
from scan3d_twin.core.navigation.motion_control import stopping, turn_by, turn_to
from scan3d_twin.core.scanning.extrinsics import corrected
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Pose2,
    RangeImage,
    ScanLine,
    read_only,
    wrap,
)

LOST_LINE = 1.6
"""A step of more than this many line spacings means that a line is missing."""
LOOK_GAP = 5.0
"""The same for a look around, which only has to find the target: 10 deg at the default rate."""
RUN_UP = 3
"""Line spacings turned before the first and after the last wanted line, to get up to speed."""
PATIENCE = 20
"""A lidar that sends nothing for so many line periods is away: the robot stops and waits."""
OUTAGE = 60.0
"""A lidar that is away for longer ends the sweep [s]: time to plug it in again, and for the 3 s
its motor takes to get up to speed; assumption."""
BUNCH = 8
"""Lines that are read at once where that takes less than one by one."""
HOLE = 10
"""So many sample periods without odometry are a hole, in which nobody knows how the robot turned:
the lines in it are lost."""

Lines = list[tuple[ScanLine, FloatArray]]
"""Lines with each beam's heading relative to the middle of the sweep (n_beams,) [rad]."""


def read_lines(robot: Robot, since: float, until: float) -> Iterator[ScanLine]:
    """Yield the lines of the time from ``since`` to ``until`` [s], and the first one after it.

    A line arrives a turn of the mirror or more after it was measured, so its own time counts. Each
    comes as it arrives, or a few at a time from a lidar that likes it better.
    """
    period = robot.lidar.spec.line_period
    if isinstance(robot.lidar, BunchingLidar):
        while (left := until - robot.clock.now()) > period:
            robot.clock.sleep(min(BUNCH * period, left))
            yield from robot.lidar.read_waiting(since)
    timeout, stamp = PATIENCE * period, -math.inf
    while stamp < until and robot.clock.now() < until + timeout:
        line = robot.lidar.read_line(timeout)
        stamp = line.stamp
        if stamp >= since:
            yield line


def sweep(
    robot: Robot,
    yaw: float,
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Observation:
    """Scan ``config.sweep.width`` and margins around the heading ``yaw`` in ``odom`` [rad].

    Raises:
        DataLossError: Lines are still missing after ``config.sweep.retries`` more passes.
        MotionTimeoutError, HazardError, LinkTimeoutError: From the robot.
    """
    half, rate = config.sweep.width / 2 + config.sweep.margin, config.sweep.yaw_rate
    started = robot.clock.now()
    lines = _scan(robot, _Sector(yaw, half, rate, LOST_LINE), config, on_line)
    spacing = rate * robot.lidar.spec.line_period
    kept = [item for item in lines if abs(_front_yaw(item[1])) <= half + spacing / 2]
    return corrected(_observation(robot, kept, yaw, started), config.mount)


def take_panorama(
    robot: Robot,
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Observation:
    """Scan one full turn coarsely from where the robot stands; a few lost lines do not matter.

    The robot turns half a turn back before and after, so that an error of its wheel base, which
    falsifies every turn by the same share, cancels.

    Raises:
        DataLossError, HazardError, LinkTimeoutError: As for ``sweep``.
    """
    started = robot.clock.now()
    yaw = robot.base.odometry().T_odom_base.yaw
    sector = _Sector(yaw, math.pi, config.sweep.look_rate, LOOK_GAP, rightwards=False)
    lines = _scan(robot, sector, config, on_line)
    turn_by(robot, -math.pi, config.motion)
    turn_to(robot, yaw, config.motion)
    return corrected(_observation(robot, lines, yaw, started), config.mount)


def find_missing(
    yaws: FloatArray, half: float, spacing: float, gap: float = LOST_LINE
) -> list[tuple[float, float]]:
    """Return the intervals (left, right) [rad], left > right, in which lines are missing.

    Args:
        yaws: Headings of the lines there are, in any order (n,) [rad].
        half: The sweep reaches from ``half`` to ``-half`` [rad].
        spacing: Nominal angle between two lines [rad].
        gap: A step of more than this many spacings means that lines are missing.
    """
    edges = np.concatenate(([half + spacing / 2], -np.sort(-yaws), [-half - spacing / 2]))
    wide = -np.diff(edges) > gap * spacing
    return [(float(edges[i]), float(edges[i + 1])) for i in np.flatnonzero(wide)]


@dataclass(frozen=True, slots=True)
class _Sector:
    """What is to be scanned.

    Attributes:
        yaw: Heading of its middle in ``odom`` [rad].
        half: Half its angle [rad].
        rate: At which the robot turns [rad/s].
        gap: See ``find_missing``.
        rightwards: Which way the first pass goes; None is from the nearer end.
    """

    yaw: float
    half: float
    rate: float
    gap: float
    rightwards: bool | None = None


def _scan(
    robot: Robot,
    sector: _Sector,
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Lines:
    """Return the lines of ``sector`` and somewhat beyond, those that were lost scanned again."""
    half, spacing = sector.half, sector.rate * robot.lidar.spec.line_period
    heading = wrap(robot.base.odometry().T_odom_base.yaw - sector.yaw)
    rightwards = heading >= 0 if sector.rightwards is None else sector.rightwards
    ends = (half, -half) if rightwards else (-half, half)
    lines = _pass(robot, sector, ends, config, on_line)
    for _ in range(config.sweep.retries):
        missing = find_missing(_front_yaws(lines), half, spacing, sector.gap)
        if not missing:
            break
        for left, right in missing:
            again = _pass(robot, sector, (left, right), config, on_line)
            inside = [item for item in again if right < _front_yaw(item[1]) < left]
            lines.extend(inside)
    missing = find_missing(_front_yaws(lines), half, spacing, sector.gap)
    if missing:
        raise DataLossError(
            f"{len(missing)} gaps in the sweep are left after {config.sweep.retries} more passes; "
            "check the lidar's cable and baud rate, or allow more sweep.retries"
        )
    return lines


def _pass(
    robot: Robot,
    sector: _Sector,
    ends: tuple[float, float],
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Lines:
    """Turn from ``ends[0]`` to ``ends[1]`` (relative to the sector's middle); return the lines.

    If the lidar goes away meanwhile, the robot stops and waits for it; then there are fewer lines.
    """
    yaw, rate, period = sector.yaw, sector.rate, robot.lidar.spec.line_period
    direction = math.copysign(1.0, ends[1] - ends[0])
    margin = RUN_UP * rate * period
    here = wrap(robot.base.odometry().T_odom_base.yaw - yaw)
    turn_by(robot, ends[0] - direction * margin - here, config.motion)
    robot.clock.sleep(config.sweep.settle)
    started = robot.clock.now()
    duration = (abs(ends[1] - ends[0]) + 2 * margin) / rate
    lines: list[ScanLine] = []
    away = False
    with stopping(robot.base):
        robot.base.set_velocity(0.0, direction * rate)
        try:
            for line in read_lines(robot, started, started + duration):
                on_line(line)
                lines.append(line)
        except LinkTimeoutError:
            away = True
    robot.clock.sleep(2 * robot.base.spec.sample_period)
    headed = _deskew(robot, lines, started, yaw, ends[0] - direction * margin)
    if away:
        robot.lidar.read_line(timeout=OUTAGE)
    return headed


def _deskew(robot: Robot, lines: list[ScanLine], started: float, yaw: float, first: float) -> Lines:
    """Give each beam the heading it had, relative to ``yaw``; the turn began near ``first``.

    Lines during which the odometry has a hole are left out.
    """
    odometry = robot.base.odometry_since(started)
    stamps = np.array([sample.stamp for sample in odometry])
    headings = np.unwrap([sample.T_odom_base.yaw for sample in odometry])
    headings += first + wrap(float(headings[0]) - yaw - first) - headings[0]
    if not lines:
        return []
    times = np.array([line.stamp for line in lines])[:, None] + robot.lidar.spec.beam_times
    holes = np.flatnonzero(np.diff(stamps) > HOLE * robot.base.spec.sample_period)
    after, before = times[:, :1] < stamps[holes + 1], times[:, -1:] > stamps[holes]
    whole = ~np.any(after & before, axis=1)
    yaws = np.interp(times, stamps, headings)
    return [pair for pair, kept in zip(zip(lines, yaws, strict=True), whole, strict=True) if kept]


def _front_yaw(yaws: FloatArray) -> float:
    return float(yaws[len(yaws) // 2])


def _front_yaws(lines: Lines) -> FloatArray:
    return np.array([_front_yaw(yaws) for _, yaws in lines])


def _observation(robot: Robot, lines: Lines, yaw: float, started: float) -> Observation:
    """Assemble the lines, left to right, into a range image at the mean place of the turn."""
    if not lines:
        raise DataLossError("the lidar sent no line during the sweep; check its cable and laser")
    lines = sorted(lines, key=lambda item: -_front_yaw(item[1]))
    poses = [sample.T_odom_base for sample in robot.base.odometry_since(started)]
    turning = poses[len(poses) // 2 :]
    image = RangeImage(
        stamps=read_only([line.stamp for line, _ in lines]),
        yaws=read_only([yaws for _, yaws in lines]),
        ranges=read_only([line.ranges for line, _ in lines]),
        codes=read_only([line.codes for line, _ in lines], np.int64),
        spec=robot.lidar.spec,
        T_base_lidar=read_only(robot.T_base_lidar),
    )
    x = float(np.mean([pose.x for pose in turning]))
    y = float(np.mean([pose.y for pose in turning]))
    return Observation(image, Pose2(x, y, yaw))
