"""A move as turns and drives: measured from odometry, or assumed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.navigation.legs import assume_legs, check_legs, measure_legs
from scan3d_twin.core.types import Pose2


def drive(*commands: tuple[float, float, float]) -> list[Pose2]:
    """Return the poses of a robot that follows (speed, turn rate, duration) one by one."""
    base = KinematicBase()
    clock = JumpingClock(base)
    for linear, angular, duration in commands:
        base.set_velocity(linear, angular)
        clock.sleep(duration)
    return [sample.T_odom_base for sample in base.odometry_since(0.0)]


def test_turns_are_not_wrapped() -> None:
    poses = drive((0.0, 0.5, 8.0), (0.2, 0.0, 3.0), (0.0, 0.5, 2.0))
    legs = measure_legs(Pose2(), poses, poses[-1].yaw)
    (first, way), (last, nothing) = legs
    assert first == pytest.approx(4.0, abs=0.02)
    assert way == pytest.approx(0.6, abs=0.005)
    assert last == pytest.approx(1.0, abs=0.02)
    assert nothing == 0.0


def test_the_sweep_before_and_after_counts_from_its_middle() -> None:
    """A sweep ends 75 deg to the right of its middle, from where the robot turns back."""
    poses = drive((0.0, 0.5, 3.0), (0.2, 0.0, 3.0), (0.0, -0.5, 4.0))
    before = Pose2(0.0, 0.0, math.radians(75.0))
    legs = measure_legs(before, poses, poses[-1].yaw + 0.3)
    assert legs[0][0] == pytest.approx(1.5 - math.radians(75.0), abs=0.02)
    assert legs[1][0] == pytest.approx(-2.0 + 0.3, abs=0.02)


def test_steering_is_one_drive_and_backing_off_is_negative() -> None:
    wobble = [(0.2, rate, 0.3) for rate in (0.05, -0.05, 0.05, -0.05)]
    poses = drive(*wobble, (-0.1, 0.0, 1.0), (0.0, 1.0, 1.0), (0.2, 0.0, 1.0))
    legs = measure_legs(Pose2(), poses, poses[-1].yaw)
    assert [round(length, 2) for _, length in legs] == [0.14, 0.2, 0.0]


@pytest.mark.parametrize("yaw", [0.4, -2.0])
def test_measured_legs_lead_to_the_move(yaw: float) -> None:
    poses = drive((0.0, -0.9, 3.0), (0.2, 0.0, 4.0), (0.0, 0.7, 2.0), (0.2, 0.0, 2.0))
    last = poses[-1]
    legs = measure_legs(Pose2(0.0, 0.0, 0.5), poses, yaw)
    move = Pose2(0.0, 0.0, 0.5).inverse() @ Pose2(last.x, last.y, yaw)
    assert check_legs(legs, move)
    assert not check_legs(legs, Pose2(move.x + 0.2, move.y, move.yaw))
    assert not check_legs(legs, Pose2(move.x, move.y, move.yaw + 0.2))
    assert not check_legs((), move)


def test_assumed_legs_turn_the_shorter_way_from_where_the_sweep_ended() -> None:
    move = Pose2(-0.6, 0.8, 0.3)
    for heading in (0.0, -1.3, 1.3):
        legs = assume_legs(move, heading)
        assert check_legs(legs, move)
        assert abs(legs[0][0] - heading) <= math.pi
    assert assume_legs(move, -1.3)[0][0] < 0.0 < assume_legs(move, 0.0)[0][0]
    ((turn, length),) = assume_legs(Pose2(0.0, 0.0, 0.3), -1.3)
    assert np.isclose(turn, 0.3)
    assert length == 0.0
