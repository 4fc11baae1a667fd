"""Motion control: closed-loop drives and turns on odometry, with a deadline, that always stop."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.errors import MotionTimeoutError
from scan3d_twin.core.hal import Clock, DriveBase, Robot
from scan3d_twin.core.types import FloatArray, Odometry, Pose2, wrap

CONTROL_PERIOD = 0.03
"""Time between two velocity commands [s]: two sensor packets of 15 ms."""
STALL_TIME = 2.0
"""Time without progress, counted in control periods, after which the robot is stuck [s]; an
assumption."""
APPROACH_GAIN = 4.0
"""Speed per remaining distance near the goal [1/s]; slow enough for the 30 ms period, an
assumption."""
STEERING_GAIN = 2.0
"""Yaw rate per heading error while driving [1/s]; an assumption."""


@contextmanager
def stopping(base: DriveBase) -> Iterator[None]:
    """Stop the wheels however the block is left."""
    try:
        yield
    finally:
        base.set_velocity(0.0, 0.0)


class ControlTicks:
    """One tick per control period, until the time is up and the robot makes no more progress.

    A robot that makes progress goes on after the deadline: on a slow computer, or after a pause, a
    move may take longer.

    Attributes:
        left: Remaining distance [m] or angle [rad], to be updated in each tick.
    """

    def __init__(self, clock: Clock, timeout: float, what: str, least: float) -> None:
        """Begin a move that should end within ``timeout`` [s].

        Args:
            clock: The robot's clock.
            timeout: Expected duration of the move at most [s].
            what: The move, in words.
            least: Smallest decrease of ``left`` that counts as progress [m] or [rad].
        """
        self.left = math.inf
        self._clock, self._timeout, self._what, self._least = clock, timeout, what, least

    def __iter__(self) -> Iterator[None]:
        """Yield once per control period.

        Raises:
            MotionTimeoutError: The time is up, and the robot makes no progress.
        """
        deadline, best, idle = self._clock.now() + self._timeout, math.inf, 0
        while self._clock.now() < deadline or idle * CONTROL_PERIOD < STALL_TIME:
            yield
            if self.left < best - self._least:
                best, idle = self.left, 0
            idle += 1
            self._clock.sleep(CONTROL_PERIOD)
        raise MotionTimeoutError(
            f"{self._what} took longer than {self._timeout:.1f} s: wheels blocked or slipping?"
        )


def turn_to(robot: Robot, yaw: float, config: MotionConfig) -> None:
    """Turn on the spot, the shorter way, until the odometry's heading is ``yaw`` [rad].

    Raises:
        MotionTimeoutError: The heading was not reached in about twice the time it needs.
        HazardError: From the robot.
    """
    turn_by(robot, wrap(yaw - robot.base.odometry().T_odom_base.yaw), config)


def turn_by(robot: Robot, angle: float, config: MotionConfig) -> None:
    """Turn on the spot by ``angle`` [rad], which may exceed half a turn; errors as ``turn_to``."""
    acceleration = 2.0 * config.acceleration / robot.base.spec.wheel_base

    # Set the deadline
    last, left, rate = robot.base.odometry().T_odom_base.yaw, angle, 0.0
    timeout = 2.0 * abs(angle) / config.turn_rate + 5.0
    what = f"a turn of {math.degrees(angle):.0f} deg"
    ticks = ControlTicks(robot.clock, timeout, what, config.yaw_tolerance)

    # Turn until the angle is reached
    with stopping(robot.base):
        for _ in ticks:
            yaw = robot.base.odometry().T_odom_base.yaw
            left, last = left - wrap(yaw - last), yaw
            ticks.left = abs(left)
            if abs(left) <= config.yaw_tolerance:
                return
            wanted = max(-config.turn_rate, min(config.turn_rate, APPROACH_GAIN * left))
            rate = _limit_acceleration(rate, wanted, acceleration * CONTROL_PERIOD)
            robot.base.set_velocity(0.0, rate)


def drive_to(robot: Robot, x: float, y: float, config: MotionConfig) -> None:
    """Turn towards (x, y) in ``odom`` [m] and drive there straight, steering back to the line.

    Raises:
        MotionTimeoutError: The place was not reached in about twice the time it needs.
        HazardError: From the robot.
    """
    # Turn towards the goal
    start = robot.base.odometry().T_odom_base
    length = math.hypot(x - start.x, y - start.y)
    if length <= config.position_tolerance:
        return
    bearing = math.atan2(y - start.y, x - start.x)
    turn_to(robot, bearing, config)

    # Set the deadline
    line, speed = Pose2(start.x, start.y, bearing), 0.0
    timeout = 2.0 * length / config.speed + 5.0
    what = f"a drive of {length:.2f} m"
    ticks = ControlTicks(robot.clock, timeout, what, config.position_tolerance)

    # Drive along the line
    with stopping(robot.base):
        for _ in ticks:
            along = line.inverse() @ robot.base.odometry().T_odom_base
            ticks.left = left = length - along.x
            if left <= config.position_tolerance:
                return
            speed = _limit_acceleration(
                speed, min(config.speed, APPROACH_GAIN * left), config.acceleration * CONTROL_PERIOD
            )
            heading = math.atan2(-along.y, max(left, 0.2))
            robot.base.set_velocity(speed, STEERING_GAIN * wrap(heading - along.yaw))


def back_off(robot: Robot, length: float, config: MotionConfig) -> None:
    """Drive ``length`` [m] straight back, slowly, and stop; errors as ``drive_to``."""
    start = robot.base.odometry().T_odom_base
    speed = config.speed / 2
    timeout = 2.0 * length / speed + 5.0
    what = f"backing off by {length:.2f} m"
    ticks = ControlTicks(robot.clock, timeout, what, config.position_tolerance)
    with stopping(robot.base):
        for _ in ticks:
            ticks.left = left = length - robot.base.odometry().T_odom_base.distance(start)
            if left <= config.position_tolerance:
                return
            robot.base.set_velocity(-min(speed, APPROACH_GAIN * left), 0.0)


def follow_path(robot: Robot, path: FloatArray, config: MotionConfig) -> None:
    """Drive along the waypoints ``path`` (n, 2) in ``odom`` [m], turning on the spot at each."""
    for x, y in path:
        drive_to(robot, float(x), float(y), config)


def measure_travel(odometry: Sequence[Odometry]) -> tuple[float, float]:
    """Return the length of the path driven [m] and the sum of all turns [rad]."""
    poses = [sample.T_odom_base for sample in odometry]
    path = sum(a.distance(b) for a, b in pairwise(poses))
    turn = sum(abs(wrap(b.yaw - a.yaw)) for a, b in pairwise(poses))
    return path, turn


def _limit_acceleration(current: float, wanted: float, step: float) -> float:
    """Return ``wanted``, but at most ``step`` faster than ``current``; it may be slower at once."""
    if abs(wanted) <= abs(current) and wanted * current >= 0:
        return wanted
    return max(current - step, min(current + step, wanted))
