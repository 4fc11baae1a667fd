"""What turns the scan plane in a sweep: the base on its wheels, or a turntable on it.

Angles are relative to the middle of the sweep. Both turn at a constant rate while lines are read,
and tell the angle at which each beam was measured (de-skewing).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError, MotionTimeoutError
from scan3d_twin.core.hal import Robot, Turntable
from scan3d_twin.core.navigation.motion_control import stopping, turn_by, turn_to
from scan3d_twin.core.scanning.calibration.extrinsics import apply_mount, lean_axis
from scan3d_twin.core.scanning.deskew import Lines, deskew_lines, deskew_table_lines
from scan3d_twin.core.scanning.patterns import (
    MAX_LEAN,
    find_axis_mount,
    find_parking_angle,
    is_ahead,
    is_through_middle,
    is_vertical,
    rotate_z,
    turn_lidar,
)
from scan3d_twin.core.types import FloatArray, ScanLine, read_only, wrap

ARRIVAL_RATE = math.radians(45.0)
"""Speed at which a turntable goes to the start of a sweep [rad/s]; that of turns of the base."""
ARRIVAL_STEPS = 3.0
"""Distance from its goal within which a turntable has arrived, in steps of its angle sensor."""
MIN_ARRIVAL = math.radians(0.05)
"""The same at least [rad]."""
MIN_PERIOD = 0.01
"""Shortest time between two looks at the angle of a turntable on its way [s]."""
PARKING_RUN_UP = math.radians(3.0)
"""Angle from below which a turntable comes to rest for a panorama [rad], more than any play."""


class Turner(Protocol):
    """What turns the scan plane."""

    def limit(self, half: float, whole: float, run_up: float) -> float:
        """Return half the angle of a sweep [rad].

        Args:
            half: Half the angle of the sector that is wanted [rad].
            whole: The same of the widest sector [rad].
            run_up: Angle turned before it and after it [rad].
        """
        ...

    def choose_rate(self, rate: float) -> float:
        """Return the turn rate at which it turns if ``rate`` is wanted [rad/s]."""
        ...

    def heading(self) -> float:
        """Return the present angle [rad]."""
        ...

    def go_to(self, angle: float) -> None:
        """Turn to ``angle`` [rad] and rest there."""
        ...

    def turning(self, end: float, rate: float) -> AbstractContextManager[None]:
        """Turn towards ``end`` [rad] at ``rate`` [rad/s], left positive, within a block."""
        ...

    def deskew(self, lines: list[ScanLine], started: float, first: float) -> Lines:
        """Return ``lines`` with the angle of each beam.

        Args:
            lines: As they were read, in order.
            started: When the turn began, on the robot's clock [s].
            first: Angle near which the turn began [rad].
        """
        ...

    @property
    def mount(self) -> tuple[FloatArray, FloatArray | None]:
        """``T_base_lidar`` and ``T_scan_axis`` of the range image (4, 4)."""
        ...


class BaseTurner:
    """The base turns on the spot; the lidar stays where it is on the base."""

    def __init__(self, robot: Robot, yaw: float, config: Config) -> None:
        """Sweep around the heading ``yaw`` in ``odom`` [rad]."""
        self._robot, self._yaw, self._config = robot, yaw, config
        self._T_base_lidar = robot.T_base_lidar

    def park_table(self) -> None:
        """Turn the turntable to where its plane is upright, if there is one, and note its mount.

        The calibrated mount is that of the lidar on the turntable: it is part of this.
        """
        robot = self._robot
        if robot.turntable is None:
            return
        assert robot.T_base_axis is not None
        angle = find_parking_angle(robot.T_base_axis)
        turn_table(robot, robot.turntable, angle - PARKING_RUN_UP, ARRIVAL_RATE)
        turn_table(robot, robot.turntable, angle, ARRIVAL_RATE)
        mount = self._config.mount
        carried = robot.turntable.angle().angle - (robot.turntable.spec.play + mount.play) / 2
        T = apply_mount(find_axis_mount(robot.T_base_axis, robot.T_base_lidar), mount)
        axis = lean_axis(robot.T_base_axis, float(T[2, 3]), mount)
        self._T_base_lidar = np.asarray(axis @ rotate_z(carried) @ T)

    @property
    def looks_up(self) -> bool:
        """Whether the lidar looks up, to both sides of the robot: half a turn shows all round."""
        return bool(self._T_base_lidar[2, 0] > math.cos(MAX_LEAN))

    def limit(self, half: float, whole: float, run_up: float) -> float:
        """See ``Turner``: it turns on and on."""
        return half

    def choose_rate(self, rate: float) -> float:
        """See ``Turner``."""
        return rate

    def heading(self) -> float:
        """See ``Turner``."""
        return wrap(self._robot.base.odometry().T_odom_base.yaw - self._yaw)

    def go_to(self, angle: float) -> None:
        """See ``Turner``; it may be more than half a turn away."""
        turn_by(self._robot, angle - self.heading(), self._config.motion)

    @contextmanager
    def turning(self, end: float, rate: float) -> Iterator[None]:
        """See ``Turner``."""
        with stopping(self._robot.base):
            self._robot.base.set_velocity(0.0, rate)
            yield

    def deskew(self, lines: list[ScanLine], started: float, first: float) -> Lines:
        """See ``Turner``: by the whole odometry."""
        self._robot.clock.sleep(2 * self._robot.base.spec.sample_period)
        return deskew_lines(self._robot, lines, started, self._yaw, first)

    @property
    def mount(self) -> tuple[FloatArray, FloatArray | None]:
        """See ``Turner``."""
        return read_only(self._T_base_lidar), None


class TableTurner:
    """The turntable turns the lidar while the base stands."""

    def __init__(self, robot: Robot, table: Turntable) -> None:
        if robot.T_base_axis is None:
            raise ConfigError("a robot with a turntable needs T_base_axis, the pose of its axis")
        self._robot, self._table, self._T_base_axis = robot, table, robot.T_base_axis
        self._is_rightwards = False

    def limit(self, half: float, whole: float, run_up: float) -> float:
        """See ``Turner``.

        A pitched or rolled plane sees the whole sector that is wanted in each of its lines: it
        turns as far as it takes, whatever the width of the sector. Half a turn about the direction
        ahead shows all.
        """
        spec = self._table.spec
        if not is_vertical(self._T_base_axis):
            half = math.pi / 2 if is_ahead(self._T_base_axis) else whole
        return min(half, spec.max_angle - run_up, -spec.min_angle - run_up)

    def choose_rate(self, rate: float) -> float:
        """See ``Turner``: a servo turns at whole steps of its speed."""
        return self._table.turn_to(self._table.angle().angle, rate)[1]

    def heading(self) -> float:
        """See ``Turner``."""
        return self._table.angle().angle

    def go_to(self, angle: float) -> None:
        """See ``Turner``."""
        turn_table(self._robot, self._table, angle, ARRIVAL_RATE)

    @contextmanager
    def turning(self, end: float, rate: float) -> Iterator[None]:
        """See ``Turner``."""
        self._is_rightwards = rate < 0
        try:
            self._table.turn_to(end, abs(rate))
            yield
        finally:
            self._table.stop()

    def deskew(self, lines: list[ScanLine], started: float, first: float) -> Lines:
        """See ``Turner``: what is carried trails the angle sensor by half the play."""
        self._robot.clock.sleep(2 * self._table.spec.sample_period)
        lag = math.copysign(self._table.spec.play / 2, 1.0 if self._is_rightwards else -1.0)
        return deskew_table_lines(self._robot, self._table, lines, started, lag)

    @property
    def mount(self) -> tuple[FloatArray, FloatArray | None]:
        """See ``Turner``: a vertical axis through the middle counts as that of the base."""
        robot, axis = self._robot, self._T_base_axis
        if is_through_middle(axis):
            return read_only(robot.T_base_lidar), read_only(np.eye(4))
        return read_only(find_axis_mount(axis, robot.T_base_lidar)), read_only(axis)


def choose_turner(robot: Robot, yaw: float, config: Config) -> Turner:
    """Return what turns the lidar in a sweep around the heading ``yaw`` in ``odom`` [rad].

    A base with a turntable turns to that heading first, and a stand stays as it stands.

    Raises:
        ConfigError: Nothing can turn it.
    """
    if robot.turntable is None:
        if robot.base.spec.is_stand:
            raise ConfigError("a stand does not turn: give it a turntable, as by --pattern yaw")
        return BaseTurner(robot, yaw, config)
    if not robot.base.spec.is_stand:
        turn_to(robot, yaw, config.motion)
    return TableTurner(robot, robot.turntable)


def find_lidar_pose(robot: Robot) -> FloatArray:
    """Return the pose of the lidar in ``base`` (4, 4), as the turntable stands now."""
    if robot.turntable is None or robot.T_base_axis is None:
        return robot.T_base_lidar
    return turn_lidar(robot.T_base_axis, robot.T_base_lidar, robot.turntable.angle().angle)


def turn_table(robot: Robot, table: Turntable, angle: float, speed: float) -> None:
    """Turn ``table`` to ``angle`` [rad] at ``speed`` [rad/s], and return when it is there.

    Raises:
        MotionTimeoutError: It was not there in twice the time it needs, and a second.
    """
    # Begin to turn
    goal, rate = table.turn_to(angle, speed)
    near = max(MIN_ARRIVAL, ARRIVAL_STEPS * table.spec.resolution)
    period = max(table.spec.sample_period, MIN_PERIOD)
    allowed = 2.0 * abs(goal - table.angle().angle) / rate + 1.0
    deadline = robot.clock.now() + allowed

    # Wait for it
    while abs(table.angle().angle - goal) > near:
        if robot.clock.now() > deadline:
            table.stop()
            raise MotionTimeoutError(
                f"the turntable did not reach {math.degrees(goal):.0f} deg in {allowed:.1f} s: "
                "blocked or overloaded?"
            )
        robot.clock.sleep(period)
