"""Putting a robot where a recorded run was, so that the run can go on.

In the twin the recorded commands are given once more at the same steps of the physics, nobody
looking: one seed gives the same bits, so that a run that goes on is the run that was never stopped.
A real robot must not have been moved; its odometry and clock are carried on from what was recorded.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

from scan3d_twin.core.errors import HazardError, RegistrationError, ScanError
from scan3d_twin.core.hal import BaseSpec, Clock, DriveBase, Lidar, Robot
from scan3d_twin.core.registration import PosePrior, extract_surfels, register
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Hazards, LidarSpec, Odometry, Pose2, ScanLine, rms, wrap
from scan3d_twin.recording.session_log import Mark

HALF_STEP = 0.001
"""The twin's clock moves in steps of 2 ms; half of one keeps rounding from adding another [s]."""
SAME_PLACE, SAME_HEADING = 0.005, math.radians(0.5)
"""Odometry that is off by less has the same view ahead [m], [rad]: a range error at 1 m."""
PAUSE = 1.0
"""On the robot's clock, between what was recorded and what goes on [s]."""
MOVED = 0.10
"""A first view that lies farther from where odometry has it was taken from elsewhere [m]: three
times what odometry is off after 1 m, 3 % of the way."""
SEARCH_XY, SEARCH_YAW, STARTS = 0.2, math.radians(10.0), 32
"""Where it is looked for: somebody has pushed the robot a little [m], [rad]; assumption."""

Command = tuple[float, float, float]
"""Stamp [s], speed [m/s] and turn rate [rad/s]."""


def reenact(robot: Robot, commands: Iterable[Command], mark: Mark) -> bool:
    """Give ``robot``, a twin just opened, the recorded ``commands`` up to ``mark``.

    Returns:
        Whether it is where it was, bit by bit; computers that round otherwise put it beside.

    Raises:
        ScanError: It is somewhere else.
    """
    for stamp, linear, angular in commands:
        _wait_until(robot.clock, stamp)
        robot.base.set_velocity(linear, angular)
    _wait_until(robot.clock, mark.stamp)
    here, there = robot.base.odometry().T_odom_base, mark.T_odom_base
    if here == there:
        return True
    if here.distance(there) > SAME_PLACE or abs(wrap(here.yaw - there.yaw)) > SAME_HEADING:
        raise ScanError(
            f"the twin now goes another way than recorded ({here.distance(there):.3f} m off): the "
            "run cannot go on with this version; `twin session info` names the one that recorded it"
        )
    return False


def _wait_until(clock: Clock, stamp: float) -> None:
    """Let time pass; a hazard that was met then is met again."""
    while (left := stamp - clock.now()) > HALF_STEP:
        with suppress(HazardError):
            clock.sleep(left - HALF_STEP)


def continued(robot: Robot, T_odom_here: Pose2, stamp: float) -> Robot:
    """Return ``robot``, just opened, with its odometry and clock carried on.

    Args:
        robot: Stands where the recorded run left it.
        T_odom_here: Where that was by the recorded odometry.
        stamp: The latest one that was recorded [s].
    """
    later = stamp + PAUSE - robot.clock.now()
    clock = _LaterClock(robot.clock, later)
    T_odom_opened = T_odom_here @ robot.base.odometry().T_odom_base.inverse()
    base = _ContinuedBase(robot.base, T_odom_opened, later)
    return replace(robot, base=base, lidar=_LaterLidar(robot.lidar, later), clock=clock)


class _LaterClock:
    """A ``Clock`` that is ahead of another."""

    def __init__(self, clock: Clock, later: float) -> None:
        self._clock = clock
        self._later = later
        self.sleep = clock.sleep

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._clock.now() + self._later


class _LaterLidar:
    """A ``Lidar`` by that clock."""

    def __init__(self, lidar: Lidar, later: float) -> None:
        self._lidar = lidar
        self._later = later

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar.spec``."""
        return self._lidar.spec

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        line = self._lidar.read_line(timeout)
        return replace(line, stamp=line.stamp + self._later)


class _ContinuedBase:
    """A ``DriveBase`` by that clock whose odometry does not begin at the origin."""

    def __init__(self, base: DriveBase, T_odom_opened: Pose2, later: float) -> None:
        self._base = base
        self._T_odom_opened = T_odom_opened
        self._later = later
        self.set_velocity = base.set_velocity

    @property
    def spec(self) -> BaseSpec:
        """See ``DriveBase.spec``."""
        return self._base.spec

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``; the covariance is that since opening."""
        return self._carried_on(self._base.odometry())

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        since = self._base.odometry_since(stamp - self._later)
        return tuple(self._carried_on(sample) for sample in since)

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._base.hazards()

    def _carried_on(self, sample: Odometry) -> Odometry:
        return Odometry(
            sample.stamp + self._later,
            self._T_odom_opened @ sample.T_odom_base,
            sample.covariance,
        )


def warning(session: Session) -> str:
    """Return what to say of the first view that was taken after going on; empty if all is well.

    It is laid on the one before it once more, trusting the odometry far less than usually. Where
    the scene cannot tell, as along a wall, a robot that was moved along it is not found out.
    """
    previous, view = session.views[-2:]
    move = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    prior = PosePrior.planar(move, SEARCH_XY, SEARCH_YAW)
    grids = [extract_surfels(each.observation.image, keep=each.sweep) for each in (previous, view)]
    try:
        found = register(*grids, prior=prior, starts=STARTS)
    except RegistrationError:
        return "the first view after going on shows nothing known: was the robot moved?"
    truly, points = Pose2.from_matrix(found.T_target_source), view.target.points
    off = max(truly.distance(move), rms(truly.apply(points) - move.apply(points)))
    if off > MOVED:
        return (
            f"the first view after going on lies {100 * off:.0f} cm from where the odometry has "
            "it: was the robot moved?"
        )
    return ""
