import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic
from kinematic import JumpingClock, KinematicBase
from paper import paper_config
from recorded import line

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import drive_to, turn_by
from scan3d_twin.core.observer import with_clock_callbacks
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.resume import RESUME_PAUSE, continue_odometry, moved_warning, reenact
from scan3d_twin.recording.session_log import Mark
from scan3d_twin.sim.robot import open_sim


class Noted:
    """A base that notes its velocity commands with their times."""

    def __init__(self, robot):
        self._base, self._clock, self.book = robot.base, robot.clock, []

    def __getattr__(self, name):
        return getattr(self._base, name)

    def set_velocity(self, linear, angular):
        """Note the command with its time and pass it on."""
        self.book.append((self._clock.now(), linear, angular))
        return self._base.set_velocity(linear, angular)


def ride(robot):
    """Turn and drive a little."""
    turn_by(robot, 0.7, MotionConfig())
    drive_to(robot, 0.3, 0.2, MotionConfig())


@pytest.fixture(scope="module")
def ridden():
    """Commands of a ride, where it ended, and the line that was read next."""
    with open_sim("three_boxes", 3) as (robot, _):
        noted = Noted(robot)
        ride(replace(with_clock_callbacks(robot, lambda: None), base=noted))
        mark = Mark(robot.clock.now(), T_odom_base=robot.base.odometry().T_odom_base)
        stamp = robot.clock.now()
        while (read := robot.lidar.read_line(1.0)).stamp < stamp:
            pass
        return noted.book, mark, read


def test_a_reenacted_twin_is_the_same_bit_by_bit(ridden):
    book, mark, line = ridden
    with open_sim("three_boxes", 3) as (robot, _):
        assert reenact(robot, book, mark)
        assert robot.clock.now() == mark.stamp
        while (read := robot.lidar.read_line(1.0)).stamp < mark.stamp:
            pass
    assert read.stamp == line.stamp
    np.testing.assert_array_equal(read.ranges, line.ranges)
    np.testing.assert_array_equal(read.codes, line.codes)


def test_a_twin_that_goes_another_way_is_found_out(ridden):
    book, mark, _ = ridden
    there = mark.T_odom_base @ Pose2(0.02, 0.0, 0.0)
    with (
        open_sim("three_boxes", 3) as (robot, _),
        pytest.raises(ScanError, match=r"ends 0\.020 m off the recorded path"),
    ):
        reenact(robot, book, replace(mark, T_odom_base=there))


def test_a_twin_that_is_a_little_off_is_told(ridden):
    book, mark, _ = ridden
    there = mark.T_odom_base @ Pose2(0.001, 0.0, 0.0)
    with open_sim("three_boxes", 3) as (robot, _):
        assert not reenact(robot, book, replace(mark, T_odom_base=there))


def make_robot():
    """Return a robot on a clock that only jumps, with a lidar of one line."""
    base = KinematicBase()
    lidar = SimpleNamespace(spec=synthetic.spec(), read_line=lambda timeout: line(0.5))
    return Robot(base, lidar, JumpingClock(base))


def test_odometry_and_clock_of_a_continued_robot_go_on():
    here = Pose2(1.0, -0.5, 2.0)
    robot = continue_odometry(make_robot(), here, 100.0)
    assert robot.clock.now() == 100.0 + RESUME_PAUSE
    assert robot.base.odometry().T_odom_base == here
    drive_to(robot, 1.0, 0.5, MotionConfig())
    end = robot.base.odometry()
    assert end.T_odom_base.distance(Pose2(1.0, 0.5)) < 0.02
    assert end.stamp == pytest.approx(robot.clock.now(), abs=0.016)
    assert robot.lidar.read_line(1.0).stamp == 100.0 + RESUME_PAUSE + 0.5
    samples = robot.base.odometry_since(robot.clock.now() - 1.0)
    assert len(samples) == pytest.approx(1.0 / 0.015, abs=2)
    assert samples[-1] == end


def test_a_robot_that_was_not_opened_at_the_origin_is_carried_on_too():
    robot = make_robot()
    drive_to(robot, 0.3, 0.1, MotionConfig())
    here = Pose2(1.0, -0.5, 2.0)
    again = continue_odometry(robot, here, 5.0).base.odometry().T_odom_base
    assert again.distance(here) < 1e-12
    assert math.isclose(again.yaw, here.yaw)


def taken(push):
    """Return a session of two views, before the second of which somebody pushed the robot."""
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session = Session(paper_config(), 7, hint, np.array([-1.0, 0.0]))
    session = integrate(session, synthetic.observe(Pose2(-0.4, 0.0, 0.0)))
    there = Pose2(-0.4, 0.3, 0.0)
    return integrate(session, replace(synthetic.observe(there @ push), T_odom_scan=there))


@pytest.mark.parametrize("push", [Pose2(), Pose2(0.02, -0.02, 0.01)], ids=str)
def test_a_robot_that_stayed_is_not_suspected(push):
    assert moved_warning(taken(push)) == ""


@pytest.mark.parametrize(
    "push", [Pose2(-0.2, 0.0, 0.0), Pose2(-0.15, -0.1, 0.1), Pose2(0.0, 0.0, 0.12)], ids=str
)
def test_a_robot_that_was_moved_is_noticed(push):
    assert "was the robot moved?" in moved_warning(taken(push))
