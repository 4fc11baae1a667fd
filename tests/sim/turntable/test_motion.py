import math

import numpy as np
import pytest

from scan3d_twin.sim.turntable.motion import Motion, plan_motion


def follow(motion, times):
    return np.array([motion.servo_at(time)[0] for time in times])


@pytest.mark.parametrize(
    ("angle", "speed", "goal", "cruise"),
    [
        (0.0, 0.0, 1.0, 0.1),  # a long way: cruises
        (0.0, 0.0, 0.001, 1.0),  # a short one: never reaches its speed
        (0.5, 0.4, -1.0, 0.2),  # turns the other way: stops first
        (0.0, 0.8, 1.0, 0.2),  # too fast: slows down
        (0.0, 0.8, 0.05, 0.2),  # passes its goal, and comes back
        (0.3, 0.0, 0.3, 0.2),  # is there
    ],
)
def test_a_motion_ends_at_rest_at_its_goal_within_speed_and_acceleration(
    angle, speed, goal, cruise
):
    end, rate = angle, speed
    for duration, acceleration in plan_motion(angle, speed, goal, cruise, 2.0):
        assert duration >= 0
        assert abs(acceleration) <= 2.0
        end += rate * duration + acceleration / 2 * duration**2
        rate += acceleration * duration
        assert abs(rate) <= max(cruise, abs(speed)) + 1e-12
    assert end == pytest.approx(goal, abs=1e-9)
    assert rate == pytest.approx(0.0, abs=1e-9)


def test_a_turn_takes_the_time_of_its_trapezoid():
    steps = plan_motion(0.0, 0.0, 1.0, 0.5, 2.0)
    assert sum(duration for duration, _ in steps) == pytest.approx(1.0 / 0.5 + 0.5 / 2.0)


def test_a_new_command_goes_on_from_where_it_is():
    motion = Motion(0.0, math.inf)
    motion.turn(0.0, 1.0, 0.5, 2.0)
    motion.turn(1.0, -1.0, 0.5, 2.0)
    times = np.linspace(0.0, 6.0, 6001)
    angles = follow(motion, times)
    assert np.max(np.abs(np.diff(angles))) <= 0.5 * 0.001 + 1e-9  # it never jumps
    assert np.max(angles) == pytest.approx(0.4375 + 0.5**2 / 4)  # 0.4375 by 1 s, and braking
    assert angles[-1] == pytest.approx(-1.0)


def test_what_is_carried_trails_by_half_the_play():
    motion = Motion(0.1, math.inf)
    motion.turn(0.0, 1.0, 0.5, 2.0)
    times = np.linspace(0.0, 3.0, 301)
    carried = motion.carried_at(times)
    servo = follow(motion, times)
    assert np.all(carried[servo < 0.05] == 0.0)  # not before the play is taken up
    assert carried[servo >= 0.05] == pytest.approx(servo[servo >= 0.05] - 0.05, abs=1e-12)
    motion.turn(3.0, 0.0, 0.5, 2.0)
    assert motion.carried_at(np.array([3.1, 9.0])) == pytest.approx([0.95, 0.05])


def test_the_past_is_known_for_as_long_as_it_is_kept():
    motion = Motion(0.0, 10.0)
    for k in range(100):
        motion.turn(float(k), k % 2, 1.0, 4.0)
    assert len(motion._pieces) < 60
    assert motion.carried_at(np.array([95.9, 97.9])) == pytest.approx([1.0, 1.0], abs=0.5)


def test_stopping_brakes():
    motion = Motion(0.0, math.inf)
    motion.turn(0.0, 1.0, 0.5, 2.0)
    motion.stop(1.0, 2.0)
    assert motion.servo_at(1.0) == pytest.approx((0.4375, 0.5))
    assert motion.servo_at(5.0) == pytest.approx((0.4375 + 0.0625, 0.0))
