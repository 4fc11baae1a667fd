import math

import numpy as np
import pytest

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.sim.config import LidarModelConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim


def story(seed, config=None):
    """Return the lines, odometry and true poses of a small run."""
    with open_sim("three_boxes", seed, config) as (robot, truth):
        robot.base.set_velocity(0.1, 0.3)
        lines = [robot.lidar.read_line(1.0) for _ in range(8)]
        robot.base.set_velocity(0.0, 0.0)
        robot.clock.sleep(0.3)
        odometry = robot.base.odometry_since(0.0)
        return lines, odometry, truth.pose_at(robot.clock.now())


def test_the_same_seed_gives_the_same_bits():
    (lines, odometry, pose), (lines2, odometry2, pose2) = story(3), story(3)
    assert pose == pose2
    for a, b in zip(lines, lines2, strict=True):
        assert a.stamp == b.stamp
        assert a.ranges.tobytes() == b.ranges.tobytes()
        assert a.codes.tobytes() == b.codes.tobytes()
    for a, b in zip(odometry, odometry2, strict=True):
        assert (a.stamp, a.T_odom_base) == (b.stamp, b.T_odom_base)
        assert a.covariance.tobytes() == b.covariance.tobytes()


def test_another_seed_gives_another_robot_and_other_noise():
    (lines, _, pose), (lines2, _, pose2) = story(3), story(4)
    assert pose != pose2
    assert lines[0].ranges.tobytes() != lines2[0].ranges.tobytes()


def test_unread_lines_do_not_change_later_ones():
    def last(skip):
        with open_sim("three_boxes", 5) as (robot, _):
            if skip:
                robot.clock.sleep(2.0)
            line = robot.lidar.read_line(3.0)
            while line.stamp < 2.5:
                line = robot.lidar.read_line(3.0)
            return line

    a, b = last(skip=True), last(skip=False)
    assert a.stamp == b.stamp
    assert a.ranges.tobytes() == b.ranges.tobytes()


def test_the_lidars_parameters_do_not_change_the_robot():
    assert story(3)[2] == story(3, TwinConfig(lidar=LidarModelConfig(sigma=0.02)))[2]


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, RuntimeError])
def test_leaving_stops_the_wheels_in_every_way(error):
    try:
        with open_sim("three_boxes", 0) as (robot, _):
            robot.base.set_velocity(0.0, 0.5)
            robot.clock.sleep(0.5)
            world = robot.base._world
            assert np.abs(world.data.ctrl).max() > 1.0
            if error is not None:
                raise error
    except (KeyboardInterrupt, RuntimeError):
        pass
    assert not world.data.ctrl.any()


def test_odometry_and_truth_start_together():
    with open_sim("three_boxes", 0) as (robot, truth):
        assert robot.clock.now() == 0.0
        assert truth.pose_at(0.0).distance(truth.spawn) < 1e-3
        assert abs(truth.pose_at(0.0).yaw) < math.radians(0.05)


def test_an_unknown_scene_is_named():
    with pytest.raises(UnknownNameError, match="no scene 'atlantis'"), open_sim("atlantis", 0):
        pass
