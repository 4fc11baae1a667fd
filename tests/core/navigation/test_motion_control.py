import math

import pytest
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.errors import MotionTimeoutError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import (
    STALL_TIME,
    ControlTicks,
    back_off,
    drive_to,
    turn_by,
)

CONFIG = MotionConfig()


class Slowed(KinematicBase):
    """A base that only does ``share`` of what it is commanded, as in a world that runs slowly."""

    share = 1.0

    def _followed(self):
        return tuple(self.share * speed for speed in super()._followed())


def robot(share):
    """Return a robot that does only ``share`` of what it is commanded."""
    base = Slowed()
    base.share = share
    return Robot(base, None, JumpingClock(base))


MOVES = {
    "turn": (lambda robot: turn_by(robot, math.pi, CONFIG), 2 * math.pi / CONFIG.turn_rate + 5.0),
    "drive": (lambda robot: drive_to(robot, 1.0, 0.0, CONFIG), 2 * 1.0 / CONFIG.speed + 5.0),
    "back": (lambda robot: back_off(robot, 0.12, CONFIG), 4 * 0.12 / CONFIG.speed + 5.0),
}


@pytest.mark.parametrize("name", MOVES)
def test_a_robot_that_is_slow_but_gets_on_gets_there(name):
    move, timeout = MOVES[name]
    slow = robot(0.1)
    move(slow)
    pose = slow.base.odometry().T_odom_base
    reached = {"turn": abs(pose.yaw) - math.pi, "drive": pose.x - 1.0, "back": pose.x + 0.12}
    assert abs(reached[name]) < 0.011
    assert slow.clock.now() > timeout
    assert slow.base.speed == (0.0, 0.0)


@pytest.mark.parametrize("name", MOVES)
def test_a_robot_that_is_stuck_is_given_up_when_the_time_is_up(name):
    move, timeout = MOVES[name]
    stuck = robot(0.0)
    with pytest.raises(MotionTimeoutError, match=f"took longer than {timeout:.1f} s"):
        move(stuck)
    assert stuck.clock.now() == pytest.approx(timeout, abs=0.1)
    assert stuck.base.speed == (0.0, 0.0)


def test_a_robot_that_gets_stuck_later_is_given_up_soon_after():
    slow = robot(0.1)
    ticks = ControlTicks(slow.clock, 1.0, "a move", 0.01)

    def move():
        for _ in ticks:
            ticks.left = 10.0 - 0.1 * min(10.0, slow.clock.now())

    with pytest.raises(MotionTimeoutError):
        move()
    assert slow.clock.now() == pytest.approx(10.0 + STALL_TIME, abs=0.3)


def test_a_pause_in_which_nobody_looked_is_no_standstill():
    slow = robot(1.0)
    ticks = iter(ControlTicks(slow.clock, 1.0, "a move", 0.01))
    next(ticks)
    slow.clock.sleep(30.0)
    next(ticks)
