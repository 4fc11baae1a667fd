import numpy as np
import pytest

from scan3d_twin.core.errors import HazardError, TwinError


def drive_into_the_wall(robot, wait):
    """Drive ahead until a hazard; return when the last call before it returned."""
    robot.base.set_velocity(0.2, 0.0)
    before = robot.clock.now()
    while robot.clock.now() < 15.0:
        before = robot.clock.now()
        wait(robot)
    return before


def small_sleep(robot):
    robot.clock.sleep(0.02)


def small_read(robot):
    robot.lidar.read_line(1.0)


def test_the_lidar_sits_where_the_mount_says(robot):
    T = robot.T_base_lidar
    assert np.allclose(T[:3, :3], np.eye(3))
    assert T[:3, 3] == pytest.approx([0.05, 0.0, 0.30])


@pytest.mark.parametrize("wait", [small_sleep, small_read])
def test_a_bump_stops_the_robot_and_says_so(open_in, wait):
    robot = open_in("plain_wall")
    with pytest.raises(HazardError, match="bump"):
        drive_into_the_wall(robot, wait)
    assert robot.base.hazards().active()
    stopped = robot.base.odometry().T_odom_base
    assert stopped.x == pytest.approx(1.30 - robot.base.spec.radius, abs=0.03)
    robot.base.set_velocity(0.0, 0.0)
    robot.clock.sleep(0.5)
    assert robot.base.odometry().T_odom_base.distance(stopped) < 0.01


def test_a_hazard_is_raised_within_50_ms(open_in):
    robot = open_in("plain_wall")
    robot.base.set_velocity(0.2, 0.0)
    with pytest.raises(HazardError):
        robot.clock.sleep(15.0)
    # The wheels go on turning on the spot while the wall holds the robot: .2 m/s x 50 ms = 10 mm.
    touch = 1.30 - robot.base.spec.radius
    assert robot.base.odometry().T_odom_base.x - touch < 0.010 + 0.02 * touch


def test_the_robot_can_back_off_from_a_bump(open_in):
    robot = open_in("plain_wall")
    with pytest.raises(HazardError):
        drive_into_the_wall(robot, small_sleep)
    at_wall = robot.base.odometry().T_odom_base
    robot.base.set_velocity(-0.1, 0.0)
    robot.clock.sleep(1.0)
    robot.base.set_velocity(0.0, 0.0)
    assert at_wall.x - robot.base.odometry().T_odom_base.x == pytest.approx(0.1, abs=0.03)
    assert robot.base.hazards().active() == ()


def test_driving_on_into_a_hazard_raises_again(open_in):
    robot = open_in("plain_wall")
    with pytest.raises(HazardError):
        drive_into_the_wall(robot, small_sleep)
    robot.base.set_velocity(0.1, 0.0)
    with pytest.raises(HazardError, match="bump"):
        robot.clock.sleep(0.5)


def test_errors_are_of_the_library(open_in):
    with pytest.raises(TwinError, match="three_boxes"):
        open_in("no_such_scene")
