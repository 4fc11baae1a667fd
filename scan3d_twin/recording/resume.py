"""Brings a robot to where a recorded run stopped, so that the run can be resumed.

In the twin the recorded commands are replayed at the same physics steps: one seed gives the same
bits, so that a resumed run equals one that was never interrupted. A real robot must not have been
moved; its odometry and clock continue from the recorded ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

from scan3d_twin.core.errors import HazardError, RegistrationError, ScanError
from scan3d_twin.core.hal import BaseSpec, Clock, DriveBase, Lidar, Robot, Turntable, TurntableSpec
from scan3d_twin.core.registration import PosePrior, extract_surfels, register
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import (
    Hazards,
    LidarSpec,
    Odometry,
    Pose2,
    ScanLine,
    TableAngle,
    rms,
    wrap,
)
from scan3d_twin.recording.session_log import Mark

HALF_STEP = 0.001
"""Half a step of the twin's clock [s], so that rounding adds no further step of 2 ms."""
MAX_DISTANCE_OFF, MAX_HEADING_OFF = 0.005, math.radians(0.5)
"""Largest difference of odometry after the replay [m], [rad]: the range error at 1 m."""
RESUME_PAUSE = 1.0
"""Gap on the robot's clock between the recorded and the resumed part [s]."""
MOVED_DISTANCE = 0.10
"""Distance between registration and odometry from which a robot counts as moved [m]: three times
the odometry error after 1 m, which is 3 % of the path."""
SEARCH_XY, SEARCH_YAW, STARTS = 0.2, math.radians(10.0), 32
"""Search range and starts of that registration [m], [rad]: a robot pushed a little; assumption."""

Command = tuple[float, float, float]
"""Stamp [s], speed [m/s] and turn rate [rad/s]."""


def reenact(robot: Robot, commands: Iterable[Command], mark: Mark) -> bool:
    """Replay the recorded ``commands`` up to ``mark`` on ``robot``, a twin just opened.

    Returns:
        Whether the odometry equals the recorded one bit by bit; it differs a little on a computer
        that rounds differently.

    Raises:
        ScanError: The robot ended up somewhere else.
    """
    # Replay the commands
    for stamp, linear, angular in commands:
        _wait_until(robot.clock, stamp)
        robot.base.set_velocity(linear, angular)
    _wait_until(robot.clock, mark.stamp)

    # Compare with the recorded odometry
    here, there = robot.base.odometry().T_odom_base, mark.T_odom_base
    if here == there:
        return True
    if here.distance(there) > MAX_DISTANCE_OFF or abs(wrap(here.yaw - there.yaw)) > MAX_HEADING_OFF:
        raise ScanError(
            f"the twin ends {here.distance(there):.3f} m off the recorded path: this version "
            "cannot resume the run; `twin session info` names the version that recorded it"
        )
    return False


def _wait_until(clock: Clock, stamp: float) -> None:
    """Let time pass until ``stamp``; hazards of the recorded run occur again and are ignored."""
    while (left := stamp - clock.now()) > HALF_STEP:
        with suppress(HazardError):
            clock.sleep(left - HALF_STEP)


def continue_odometry(robot: Robot, T_odom_here: Pose2, stamp: float) -> Robot:
    """Return ``robot``, just opened, with odometry and clock that continue the recorded ones.

    Args:
        robot: Stands where the recorded run left it.
        T_odom_here: Its pose by the recorded odometry.
        stamp: The latest recorded stamp [s].
    """
    later = stamp + RESUME_PAUSE - robot.clock.now()
    clock = _ShiftedClock(robot.clock, later)
    T_odom_opened = T_odom_here @ robot.base.odometry().T_odom_base.inverse()
    base = _ContinuedBase(robot.base, T_odom_opened, later)
    table = None if robot.turntable is None else _ShiftedTurntable(robot.turntable, later)
    lidar = _ShiftedLidar(robot.lidar, later)
    return replace(robot, base=base, lidar=lidar, clock=clock, turntable=table)


class _ShiftedClock:
    """A ``Clock`` ahead of another by a constant."""

    def __init__(self, clock: Clock, later: float) -> None:
        self._clock = clock
        self._later = later
        self.sleep = clock.sleep

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._clock.now() + self._later


class _ShiftedTurntable:
    """A ``Turntable`` with stamps of the shifted clock."""

    def __init__(self, table: Turntable, later: float) -> None:
        self._table, self._later = table, later
        self.turn_to, self.stop = table.turn_to, table.stop

    @property
    def spec(self) -> TurntableSpec:
        """See ``Turntable.spec``."""
        return self._table.spec

    def angle(self) -> TableAngle:
        """See ``Turntable.angle``."""
        return self._shift(self._table.angle())

    def angles_since(self, stamp: float) -> tuple[TableAngle, ...]:
        """See ``Turntable.angles_since``."""
        return tuple(self._shift(each) for each in self._table.angles_since(stamp - self._later))

    def _shift(self, sample: TableAngle) -> TableAngle:
        return replace(sample, stamp=sample.stamp + self._later)


class _ShiftedLidar:
    """A ``Lidar`` with stamps of the shifted clock."""

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
    """A ``DriveBase`` on the shifted clock whose odometry does not start at the origin."""

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


def moved_warning(session: Session) -> str:
    """Return a warning if the first view after resuming shows a moved robot, else an empty string.

    The view is registered on the one before it with a wide prior. Along a direction that the scene
    leaves open, such as a bare wall, a displacement goes unnoticed.
    """
    # Register with a wide prior
    previous, view = session.views[-2:]
    move = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    prior = PosePrior.planar(move, SEARCH_XY, SEARCH_YAW)
    grids = [extract_surfels(each.observation.image, keep=each.sweep) for each in (previous, view)]
    try:
        found = register(*grids, prior=prior, starts=STARTS)
    except RegistrationError:
        return "the first view after resuming matches no earlier one: was the robot moved?"

    # Measure the distance to odometry
    truly, points = Pose2.from_matrix(found.T_target_source), view.target.points
    off = max(truly.distance(move), rms(truly.apply(points) - move.apply(points)))
    if off > MOVED_DISTANCE:
        return (
            f"the first view after resuming lies {100 * off:.0f} cm off its odometry: was the "
            "robot moved?"
        )
    return ""
