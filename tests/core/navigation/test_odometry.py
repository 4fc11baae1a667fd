import math

import pytest

from scan3d_twin.core.navigation.odometry import DeadReckoning, drive_arc
from scan3d_twin.core.types import Pose2
from scan3d_twin.devices.create.model import CREATE2


def test_a_full_turn_of_both_wheels_is_a_circumference():
    reckoning = DeadReckoning(CREATE2, 0, 0)
    counts = 5088
    pose = reckoning.update(1.0, counts, counts).T_odom_base
    assert pose.x == pytest.approx(10 * math.pi * 0.072)
    assert pose.y == pose.yaw == 0.0


def test_one_count_of_difference_turns_by_0_108_degrees():
    pose = DeadReckoning(CREATE2, 5, 5).update(1.0, 5, 6).T_odom_base
    assert math.degrees(pose.yaw) == pytest.approx(0.1084, abs=1e-4)


@pytest.mark.parametrize("pieces", [1, 7])
def test_arcs_are_exact(pieces):
    pose = Pose2()
    for _ in range(pieces):
        pose = pose @ drive_arc(math.pi / pieces, math.pi / 2 / pieces)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((2.0, 2.0, math.pi / 2))


def test_a_long_step_follows_the_arc():
    # The right wheel runs pi * .235 m further than the left: half a turn about the left wheel.
    count = math.pi * 0.072 / 508.8
    pose = DeadReckoning(CREATE2, 0, 0).update(1.0, 0, round(math.pi * 0.235 / count)).T_odom_base
    assert abs(pose.yaw) == pytest.approx(math.pi, abs=0.002)
    assert (pose.x, pose.y) == pytest.approx((0.0, 0.235), abs=0.001)


def test_covariance_matches_the_robots_errors_after_a_quarter_turn():
    counts = round(math.pi / 4 * 0.235 / (math.pi * 0.072 / 508.8))
    covariance = DeadReckoning(CREATE2, 0, 0).update(1.0, -counts, counts).covariance
    expected = math.hypot(0.01, 0.006 / math.sqrt(2)) * math.pi / 2
    assert math.sqrt(covariance[2, 2]) == pytest.approx(expected, rel=0.01)


def test_a_straight_arc():
    assert drive_arc(0.5, 0.0) == Pose2(0.5, 0.0, 0.0)


def test_covariance_matches_the_robots_errors_after_a_metre():
    reckoning = DeadReckoning(CREATE2, 0, 0)
    count = math.pi * 0.072 / 508.8
    for k in range(1, 101):
        odometry = reckoning.update(k * 0.015, round(k / 100 / count), round(k / 100 / count))
    sigma_x, _, sigma_yaw = (math.sqrt(odometry.covariance[i, i]) for i in range(3))
    assert sigma_x == pytest.approx(0.006 / math.sqrt(2), rel=0.02)
    assert sigma_yaw == pytest.approx(0.006 * math.sqrt(2) / 0.235, rel=0.02)
    assert odometry.covariance[1, 2] > 0
