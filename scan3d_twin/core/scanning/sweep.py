"""Sweeping: the robot turns on the spot and the vertical scan lines sweep out a range image.

A turntable may turn the lidar instead while the base stands (``turning``).
Lines are de-skewed (``deskew``), and what did not arrive is scanned again: whole lines, and wide
holes where parts of lines were lost (the data-loss check of the paper's Fig. 5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.config import Config, MountConfig
from scan3d_twin.core.errors import DataLossError, LinkTimeoutError
from scan3d_twin.core.hal import BunchingLidar, Robot
from scan3d_twin.core.line_grid import find_packed_columns, pack_columns
from scan3d_twin.core.navigation.motion_control import turn_by, turn_to
from scan3d_twin.core.scanning.calibration.extrinsics import correct_extrinsics
from scan3d_twin.core.scanning.calibration.half_turn import sees_all_round, unfold
from scan3d_twin.core.scanning.deskew import Lines
from scan3d_twin.core.scanning.lost_readings import (
    drop_doubtful,
    fill_lost,
    find_holes,
    merge_intervals,
)
from scan3d_twin.core.scanning.turning import BaseTurner, Turner, choose_turner
from scan3d_twin.core.scanning.upright import is_upright, make_upright
from scan3d_twin.core.types import (
    LOST,
    FloatArray,
    LidarSpec,
    Observation,
    Pose2,
    RangeImage,
    ScanLine,
    read_only,
)

LOST_LINE_GAP = 1.6
"""Step between two lines, in line spacings, above which a line is missing."""
PANORAMA_GAP = 5.0
"""The same for a panorama, which only has to find the target: 10 deg at the default rate."""
RUN_UP_LINES = 3
"""Angle turned before the first and after the last wanted line to get up to speed, in line
spacings."""
SILENT_PERIODS = 20
"""Line periods of silence after which the lidar counts as disconnected and the robot waits."""
MAX_OUTAGE = 60.0
"""Longest disconnection of the lidar before the sweep fails [s]: time to plug it in again, and 3 s
for its motor to get up to speed; an assumption."""
MIDDLE = math.radians(1.0)
"""Angle of a turntable to either side that is its middle [rad], as noise changes the sign of 0."""
LINES_PER_READ = 8
"""Lines that are read at once from a lidar that computes several faster than one by one."""


def read_lines(robot: Robot, since: float, until: float) -> Iterator[ScanLine]:
    """Yield the lines measured from ``since`` to ``until`` [s], and the first one after them.

    A line arrives at least a turn of the mirror after it was measured: its own stamp counts. Lines
    come one by one as they arrive, or a few at a time from a ``BunchingLidar``.
    """
    # Read several lines at once
    period = robot.lidar.spec.line_period
    if isinstance(robot.lidar, BunchingLidar):
        while (left := until - robot.clock.now()) > period:
            robot.clock.sleep(min(LINES_PER_READ * period, left))
            yield from robot.lidar.read_waiting(since)

    # Read the rest one by one
    timeout, stamp = SILENT_PERIODS * period, -math.inf
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
    half: float | None = None,
    beyond: float = 0.0,
    rightwards: bool | None = None,
) -> Observation:
    """Scan ``config.sweep.width`` and margins around the heading ``yaw`` in ``odom`` [rad].

    A stand, which nothing turns, scans all round, to the right: the play of its turntable then
    turns all its views alike.

    Args:
        robot: At rest.
        yaw: Heading of the sweep's middle in ``odom`` [rad].
        config: The effective configuration.
        on_line: Called with each line as it arrives.
        half: Half the angle of a narrower sweep [rad].
        beyond: Angle by which that goes on to one side, to the left where positive [rad]; a
            turntable goes on to both.
        rightwards: Direction of the turn; None starts at the nearer end, where that is not settled.

    Raises:
        DataLossError: Lines or parts of them are still missing after ``config.sweep.retries`` more
            passes.
        MotionTimeoutError, HazardError, LinkTimeoutError: From the robot.
    """
    whole, rate = config.sweep.width / 2 + config.sweep.margin, config.sweep.yaw_rate
    if robot.base.spec.is_stand:
        whole = half = math.pi
    left, right = find_ends(whole, half, beyond)
    middle, half = (left - right) / 2, (left + right) / 2
    turner = choose_turner(robot, yaw, config)
    if robot.turntable is not None:
        yaw, rate = robot.base.odometry().T_odom_base.yaw, turner.choose_rate(rate)
        middle, half = 0.0, max(left, right)
        half = turner.limit(half, whole, RUN_UP_LINES * rate * robot.lidar.spec.line_period)
        if rightwards is None:
            rightwards = robot.base.spec.is_stand or turner.heading() >= -MIDDLE
    started = robot.clock.now()
    sector = _Sector(yaw, half, rate, LOST_LINE_GAP, turner, rightwards, middle)
    lines = _scan_sector(robot, sector, config, on_line)
    spacing = rate * robot.lidar.spec.line_period
    kept = [item for item in lines if abs(_front_yaw(item[1]) - middle) <= half + spacing / 2]
    observation = _assemble_observation(robot, kept, sector, started, config)
    return correct_extrinsics(observation, config.mount)


def find_ends(whole: float, half: float | None, beyond: float) -> tuple[float, float]:
    """Return how far a sweep goes to the left and to the right of its heading [rad].

    Args:
        whole: The same of the whole sweep, at most [rad].
        half: Of a narrower one [rad]; None for the whole.
        beyond: Angle by which that goes on to one side, to the left where positive [rad].
    """
    half = whole if half is None else half
    return min(half + max(beyond, 0.0), whole), min(half - min(beyond, 0.0), whole)


def take_panorama(
    robot: Robot,
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Observation:
    """Scan all round coarsely where the robot stands (look around); a few lines may be lost.

    That takes a full turn, or half a turn of a lidar that sees all round (``half_turn``). The robot
    turns half of it back before and after the scan, so that an error of its wheel base, which
    changes every turn by the same share, cancels.

    Raises:
        DataLossError, HazardError, LinkTimeoutError: As for ``sweep``.
    """
    if robot.base.spec.is_stand:
        return take_table_panorama(robot, config, on_line)
    started = robot.clock.now()
    yaw = robot.base.odometry().T_odom_base.yaw
    turner = BaseTurner(robot, yaw, config)
    turner.park_table()
    both_halves = sees_all_round(robot.lidar.spec)
    half = math.pi / 2 if both_halves or turner.looks_up else math.pi
    sector = _Sector(yaw, half, config.sweep.look_rate, PANORAMA_GAP, turner, rightwards=False)
    lines = _scan_sector(robot, sector, config, on_line)
    turn_by(robot, -half, config.motion)
    turn_to(robot, yaw, config.motion)
    observation = _assemble_observation(robot, lines, sector, started, config)
    mount = config.mount
    if robot.turntable is not None:  # it knows the rest of the mount
        mount = MountConfig(yaw_scale=mount.yaw_scale, time_offset=mount.time_offset)
    seen = correct_extrinsics(observation, mount)
    if not is_upright(seen.image):
        return replace(seen, image=make_upright(seen.image))
    return replace(seen, image=unfold(seen.image)) if both_halves else seen


def take_table_panorama(
    robot: Robot, config: Config, on_line: Callable[[ScanLine], None]
) -> Observation:
    """Scan all round coarsely by the turntable, as far as it turns; the base stands.

    Raises:
        ConfigError: There is no turntable.
        DataLossError, HazardError, LinkError: As for ``sweep``.
    """
    started = robot.clock.now()
    yaw = robot.base.odometry().T_odom_base.yaw
    turner = choose_turner(robot, yaw, config)
    rate = turner.choose_rate(config.sweep.look_rate)
    run_up = RUN_UP_LINES * rate * robot.lidar.spec.line_period
    half = turner.limit(math.pi, math.pi, run_up)
    sector = _Sector(yaw, half, rate, PANORAMA_GAP, turner, rightwards=False)
    lines = _scan_sector(robot, sector, config, on_line)
    observation = _assemble_observation(robot, lines, sector, started, config)
    seen = correct_extrinsics(observation, config.mount)
    return replace(seen, image=make_upright(seen.image))


def find_missing(
    yaws: FloatArray, half: float, spacing: float, gap: float = LOST_LINE_GAP
) -> list[tuple[float, float]]:
    """Return the intervals (left, right) [rad], left > right, in which lines are missing.

    Args:
        yaws: Headings of the lines that arrived, in any order (n,) [rad].
        half: Half the angle of the sweep, from ``half`` to ``-half`` [rad].
        spacing: Nominal angle between two lines [rad].
        gap: Step in spacings above which lines are missing.
    """
    edges = np.concatenate(([half + spacing / 2], -np.sort(-yaws), [-half - spacing / 2]))
    wide = -np.diff(edges) > gap * spacing
    return [(float(edges[i]), float(edges[i + 1])) for i in np.flatnonzero(wide)]


@dataclass(frozen=True, slots=True)
class _Sector:
    """The sector to be scanned.

    Attributes:
        yaw: Heading in ``odom`` to which the yaws of its lines are relative [rad].
        half: Half its angle [rad].
        rate: Turn rate of the robot [rad/s].
        gap: See ``find_missing``.
        turner: What turns the lidar.
        rightwards: Direction of the first pass; None to start at the nearer end.
        middle: Yaw of its middle [rad].
    """

    yaw: float
    half: float
    rate: float
    gap: float
    turner: Turner
    rightwards: bool | None = None
    middle: float = 0.0


def _scan_sector(
    robot: Robot,
    sector: _Sector,
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Lines:
    """Return the lines of ``sector`` and slightly beyond, after scanning lost lines again."""
    # Scan all of it
    half = sector.half
    heading = sector.turner.heading() - sector.middle
    rightwards = heading >= 0 if sector.rightwards is None else sector.rightwards
    ends = (half, -half) if rightwards else (-half, half)
    lines = _scan_pass(robot, sector, ends, config, on_line)

    # Scan again what was lost
    for _ in range(config.sweep.retries):
        missing = _find_gaps(lines, sector, robot.lidar.spec, config)
        if not missing:
            break
        for ends in missing:
            again = _scan_pass(robot, sector, ends, config, on_line)
            inside = [
                item
                for item in again
                if min(ends) < _front_yaw(item[1]) - sector.middle < max(ends)
            ]
            lines.extend(inside)

    # Give up on lasting gaps
    missing = _find_gaps(lines, sector, robot.lidar.spec, config)
    if missing:
        raise DataLossError(
            f"{len(missing)} gaps in the sweep are left after {config.sweep.retries} more passes; "
            "check the lidar's cable and baud rate, or allow more sweep.retries"
        )
    return drop_doubtful(lines)


def _find_gaps(
    lines: Lines, sector: _Sector, spec: LidarSpec, config: Config
) -> list[tuple[float, float]]:
    """Return the intervals in which lines are missing or parts of them too wide to be filled.

    They are relative to the sector's middle. Where parts are missing, intervals whose run-ups
    overlap are one, in the order and direction of the way from the end at which the robot stands.
    """
    front, spacing = _front_yaws(lines) - sector.middle, sector.rate * spec.line_period
    missing = find_missing(front, sector.half, spacing, sector.gap)
    codes = [line.codes for line, _ in drop_doubtful(lines)]
    if not codes:
        return missing

    # Gap filling closes what is narrow along a line or across lines
    lost, widest = np.array(codes) == LOST, _find_filled_angle(sector, spec, config)
    width = widest - spacing / 2
    step = float(np.ptp(spec.elevations)) / max(1, spec.n_beams - 1)
    beams = math.ceil(config.gaps.max_angle / step) - 1
    holes = find_holes(front, lost, sector.half, spacing, width, beams)
    if not holes:
        return missing
    merged = merge_intervals(missing + holes, 2 * RUN_UP_LINES * spacing)
    is_right = 2 * front[-1] < merged[0][0] + merged[-1][1]
    return [(right, left) for left, right in reversed(merged)] if is_right else merged


def _find_filled_angle(sector: _Sector, spec: LidarSpec, config: Config) -> float:
    """Return the angle up to which holes are filled [rad]: as far as lines may be apart."""
    return max((sector.gap + 0.5) * sector.rate * spec.line_period, config.gaps.max_angle)


def _scan_pass(
    robot: Robot,
    sector: _Sector,
    ends: tuple[float, float],
    config: Config,
    on_line: Callable[[ScanLine], None],
) -> Lines:
    """Turn from ``ends[0]`` to ``ends[1]`` (relative to the sector's middle); return the lines.

    When the lidar is disconnected, the robot stops and waits for it, and lines are missing.
    """
    # Turn to the start and settle
    turner, rate, period = sector.turner, sector.rate, robot.lidar.spec.line_period
    direction = math.copysign(1.0, ends[1] - ends[0])
    margin = RUN_UP_LINES * rate * period
    first = sector.middle + ends[0] - direction * margin
    last = sector.middle + ends[1] + direction * margin
    turner.go_to(first)
    robot.clock.sleep(config.sweep.settle)

    # Read lines while turning
    started = robot.clock.now()
    duration = (abs(ends[1] - ends[0]) + 2 * margin) / rate
    lines: list[ScanLine] = []
    is_silent = False
    with turner.turning(last, direction * rate):
        try:
            for line in read_lines(robot, started, started + duration):
                on_line(line)
                lines.append(line)
        except LinkTimeoutError:
            is_silent = True

    headed = turner.deskew(lines, started, first)
    if is_silent:
        robot.lidar.read_line(timeout=MAX_OUTAGE)
    return headed


def _front_yaw(yaws: FloatArray) -> float:
    """Return the heading of the middle beam of a line [rad]."""
    return float(yaws[len(yaws) // 2])


def _front_yaws(lines: Lines) -> FloatArray:
    return np.array([_front_yaw(yaws) for _, yaws in lines])


def _assemble_observation(
    robot: Robot, lines: Lines, sector: _Sector, started: float, config: Config
) -> Observation:
    """Return the lines, left to right, as a range image at the mean place of the turn."""
    if not lines:
        raise DataLossError("the lidar sent no line during the sweep; check its cable and laser")

    # Order lines and poses
    lines = sorted(lines, key=lambda item: -_front_yaw(item[1]))
    poses = [sample.T_odom_base for sample in robot.base.odometry_since(started)]
    turning = poses[len(poses) // 2 :]

    # Assemble image and pose
    spec, (T_base_lidar, T_scan_axis) = robot.lidar.spec, sector.turner.mount
    image = RangeImage(
        stamps=read_only([_find_stamp(line, spec) for line, _ in lines]),
        yaws=read_only([yaws for _, yaws in lines]),
        ranges=read_only([line.ranges for line, _ in lines]),
        codes=read_only([line.codes for line, _ in lines], np.int64),
        spec=spec,
        T_base_lidar=T_base_lidar,
        elevations=_stack_elevations([line for line, _ in lines], spec),
        T_scan_axis=T_scan_axis,
    )
    columns = find_packed_columns(image.codes)
    image = image if columns is None else pack_columns(image, columns)
    angle = _find_filled_angle(sector, robot.lidar.spec, config)
    image = fill_lost(image, replace(config.gaps, max_angle=angle))

    # Take the mean place of the turn
    x = float(np.mean([pose.x for pose in turning]))
    y = float(np.mean([pose.y for pose in turning]))
    return Observation(image, Pose2(x, y, sector.yaw))


def _find_stamp(line: ScanLine, spec: LidarSpec) -> float:
    """Return the stamp [s] of ``line`` with which ``spec`` gives the time of its middle beam."""
    if line.beam_times is None:
        return line.stamp
    middle = spec.n_beams // 2
    return line.stamp + float(line.beam_times[middle] - spec.beam_times[middle])


def _stack_elevations(lines: list[ScanLine], spec: LidarSpec) -> FloatArray | None:
    """Return the elevations (n_lines, n_beams) [rad]; None if all lines have those of ``spec``."""
    every = [line.elevations for line in lines]
    if all(own is None for own in every):
        return None
    return read_only([spec.elevations if own is None else own for own in every])
