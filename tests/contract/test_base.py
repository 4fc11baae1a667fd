import math

import numpy as np
import pytest

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import Hazards, Pose2


def drive(robot, linear, angular, seconds):
    """Drive and stand still again; return how the odometry moved."""
    before = robot.base.odometry().T_odom_base
    robot.base.set_velocity(linear, angular)
    robot.clock.sleep(seconds)
    robot.base.set_velocity(0.0, 0.0)
    robot.clock.sleep(0.5)
    return before.inverse() @ robot.base.odometry().T_odom_base


def test_spec_is_a_base_that_can_move(robot):
    spec = robot.base.spec
    assert spec.name
    assert 0 < spec.wheel_base < 2 * spec.radius < 1
    assert 0 < spec.wheel_diameter < spec.wheel_base
    assert spec.counts_per_turn > 100
    assert spec.max_wheel_speed >= 0.1
    assert 0 < spec.sample_period <= 0.05


def test_odometry_is_the_identity_when_opened(robot):
    odometry = robot.base.odometry()
    assert odometry.T_odom_base == Pose2()
    assert not odometry.covariance.any()


def test_opening_does_not_move_the_robot(robot):
    robot.clock.sleep(1.0)
    assert robot.base.odometry().T_odom_base == Pose2()


def test_positive_angular_turns_counter_clockwise(robot):
    moved = drive(robot, 0.0, 0.5, 1.0)
    assert moved.yaw == pytest.approx(0.5, abs=0.03)
    assert math.hypot(moved.x, moved.y) < 0.005


def test_negative_angular_turns_clockwise(robot):
    assert drive(robot, 0.0, -0.5, 1.0).yaw == pytest.approx(-0.5, abs=0.03)


def test_positive_linear_drives_ahead(robot):
    moved = drive(robot, 0.2, 0.0, 1.0)
    assert moved.x == pytest.approx(0.2, abs=0.01)
    assert abs(moved.y) < 0.01


def test_negative_linear_drives_back(robot):
    assert drive(robot, -0.2, 0.0, 1.0).x == pytest.approx(-0.2, abs=0.01)


def test_an_arc_bends_to_the_side_of_its_turn(robot):
    moved = drive(robot, 0.2, 0.4, 1.0)
    assert moved.y == pytest.approx(0.5 * (1 - math.cos(0.4)), abs=0.01)


def test_a_command_holds_until_told_otherwise(robot):
    robot.base.set_velocity(0.0, 0.3)
    robot.clock.sleep(1.0)
    early = robot.base.odometry().T_odom_base.yaw
    robot.clock.sleep(2.0)
    late = robot.base.odometry().T_odom_base.yaw
    assert late - early == pytest.approx(0.6, abs=0.02)


def test_after_a_stop_the_robot_stands(robot):
    drive(robot, 0.2, 0.5, 0.5)
    stopped = robot.base.odometry().T_odom_base
    robot.clock.sleep(0.5)
    assert robot.base.odometry().T_odom_base == stopped


def test_what_can_be_driven_is_sent_as_asked(robot):
    linear, angular = robot.base.set_velocity(0.1, 0.4)
    resolution = 0.001
    assert linear == pytest.approx(0.1, abs=resolution)
    assert angular == pytest.approx(0.4, abs=2 * resolution / robot.base.spec.wheel_base)


def test_what_is_sent_is_what_is_driven(robot):
    _, angular = robot.base.set_velocity(0.0, math.radians(4.0))
    robot.clock.sleep(0.5)
    early = robot.base.odometry()
    robot.clock.sleep(4.0)
    late = robot.base.odometry()
    rate = (late.T_odom_base.yaw - early.T_odom_base.yaw) / (late.stamp - early.stamp)
    assert rate == pytest.approx(angular, rel=0.02)


def test_too_fast_a_command_is_slowed_down_on_the_same_path(robot):
    linear, angular = robot.base.set_velocity(3.0, 6.0)
    robot.base.set_velocity(0.0, 0.0)
    spec = robot.base.spec
    wheel = abs(linear) + abs(angular) * spec.wheel_base / 2
    assert wheel <= spec.max_wheel_speed + 1e-9
    assert wheel > 0.98 * spec.max_wheel_speed
    assert angular / linear == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_velocity_that_is_no_number_is_refused(robot, bad):
    with pytest.raises(ConfigError, match="finite"):
        robot.base.set_velocity(bad, 0.0)
    robot.clock.sleep(0.2)
    assert robot.base.odometry().T_odom_base == Pose2()


def test_odometry_is_fresh(robot):
    for _ in range(10):
        robot.clock.sleep(0.037)
        age = robot.clock.now() - robot.base.odometry().stamp
        assert 0.0 <= age <= 2 * robot.base.spec.sample_period


def test_odometry_since_starts_at_or_before_the_stamp_and_ends_with_the_latest(robot):
    robot.clock.sleep(0.5)
    stamp = robot.clock.now()
    robot.base.set_velocity(0.0, 0.3)
    robot.clock.sleep(1.0)
    robot.base.set_velocity(0.0, 0.0)
    samples = robot.base.odometry_since(stamp)
    assert samples[0].stamp <= stamp < samples[1].stamp
    assert samples[-1] == robot.base.odometry()


def test_odometry_since_is_in_order_and_without_gaps(robot):
    robot.base.set_velocity(0.0, 0.3)
    robot.clock.sleep(1.0)
    robot.base.set_velocity(0.0, 0.0)
    stamps = np.array([sample.stamp for sample in robot.base.odometry_since(0.0)])
    assert (np.diff(stamps) > 0).all()
    assert np.diff(stamps).max() <= 3 * robot.base.spec.sample_period


def test_covariance_is_a_covariance_and_grows_with_the_way(robot):
    drive(robot, 0.2, 0.0, 1.0)
    first = robot.base.odometry().covariance
    drive(robot, 0.0, 0.5, 1.0)
    second = robot.base.odometry().covariance
    assert first.shape == (3, 3)
    assert np.array_equal(second, second.T)
    assert np.linalg.eigvalsh(second).min() >= -1e-12
    assert second[2, 2] > first[2, 2] > 0
    assert 0.001 < math.sqrt(second[2, 2]) < 0.1


def test_covariance_does_not_grow_at_rest(robot):
    drive(robot, 0.2, 0.0, 0.5)
    before = robot.base.odometry().covariance
    robot.clock.sleep(1.0)
    assert np.array_equal(robot.base.odometry().covariance, before)


def test_covariance_cannot_be_written(robot):
    with pytest.raises(ValueError, match="read-only"):
        robot.base.odometry().covariance[0, 0] = 1.0


def test_no_hazard_on_a_free_floor(robot):
    robot.clock.sleep(0.5)
    assert robot.base.hazards().active() == ()
    assert isinstance(robot.base.hazards(), Hazards)
    assert 0.0 < robot.base.hazards().battery <= 1.0
