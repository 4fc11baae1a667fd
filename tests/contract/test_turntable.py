"""The contract of a turntable, on every backend that has one."""

import math
from itertools import pairwise

import numpy as np
import pytest

from scan3d_twin.core.hal import Turntable
from scan3d_twin.core.scanning.patterns import find_mount
from scan3d_twin.core.scanning.turning import find_lidar_pose


@pytest.fixture
def robot(open_with_turntable):
    """A robot with a turntable, in front of a scene."""
    return open_with_turntable("three_boxes")


@pytest.fixture
def table(robot):
    return robot.turntable


def wait(robot, seconds):
    robot.clock.sleep(seconds)
    return robot.turntable.angle().angle


def test_spec_is_a_turntable_that_turns_a_plane_all_round(table):
    assert isinstance(table, Turntable)
    spec = table.spec
    assert spec.name
    assert spec.min_angle < -math.pi / 2
    assert spec.max_angle > math.pi / 2
    assert spec.max_speed > 0.2
    assert 0 < spec.resolution < math.radians(0.5)
    assert 0 < spec.sample_period <= 0.05
    assert 0 <= spec.play < math.radians(5.0)


def test_it_rests_until_it_is_told_to_turn(robot, table):
    before = table.angle().angle
    assert wait(robot, 0.5) == pytest.approx(before, abs=2 * table.spec.resolution)


@pytest.mark.parametrize("goal", [0.4, -0.4])
def test_it_turns_to_an_angle_and_stays_there(robot, table, goal):
    sent, speed = table.turn_to(goal, 1.0)
    assert sent == pytest.approx(goal, abs=table.spec.resolution)
    assert speed == pytest.approx(1.0, rel=0.05)
    for _ in range(2):
        arrived = wait(robot, 1.5)
        assert arrived == pytest.approx(sent, abs=3 * table.spec.resolution)


def test_it_turns_at_the_speed_that_it_says(robot, table):
    _, speed = table.turn_to(1.0, math.radians(10.0))
    wait(robot, 1.0)
    start = table.angle()
    wait(robot, 3.0)
    end = table.angle()
    measured = (end.angle - start.angle) / (end.stamp - start.stamp)
    assert measured == pytest.approx(speed, rel=0.02)


def test_a_goal_beyond_its_limits_is_clipped(table):
    goal, speed = table.turn_to(100.0, 100.0)
    assert goal == pytest.approx(table.spec.max_angle, abs=table.spec.resolution)
    assert speed <= table.spec.max_speed + 1e-9
    table.stop()


def test_it_stops_where_it_is(robot, table):
    table.turn_to(1.0, 0.5)
    wait(robot, 1.0)
    table.stop()
    reached = wait(robot, 0.5)
    assert 0.2 < reached < 0.8
    assert wait(robot, 0.5) == pytest.approx(reached, abs=3 * table.spec.resolution)


def test_samples_come_in_order_and_are_never_of_the_future(robot, table):
    robot.clock.sleep(0.1)
    started = robot.clock.now()
    table.turn_to(0.5, 0.5)
    wait(robot, 1.0)
    samples = table.angles_since(started)
    stamps = [sample.stamp for sample in samples]
    assert stamps == sorted(set(stamps))
    assert stamps[0] <= started
    assert stamps[-1] <= robot.clock.now() + 0.005
    steps = [b - a for a, b in pairwise(stamps)]
    assert max(steps[1:]) < 3 * table.spec.sample_period
    assert samples[-1] == table.angle()


def test_each_pattern_turns_the_plane_about_its_axis(robot_of_pattern, pattern):
    robot, design = robot_of_pattern, find_mount(pattern)
    goal, _ = robot.turntable.turn_to(0.4, 1.0)
    robot.clock.sleep(1.0)
    reached = robot.turntable.angle().angle
    assert reached == pytest.approx(goal, abs=3 * robot.turntable.spec.resolution)
    assert find_lidar_pose(robot) == pytest.approx(design.lidar_at(reached))

    # A line says what the plane sees there: the floor, where it is
    rested, line = robot.clock.now(), robot.lidar.read_line(1.0)
    while line.stamp < rested:
        line = robot.lidar.read_line(1.0)
    e, T = robot.lidar.spec.elevations, design.lidar_at(reached - robot.turntable.spec.play / 2)
    beams = np.stack([np.cos(e), np.zeros_like(e), np.sin(e)], axis=1) @ T[:3, :3].T
    heights = T[2, 3] + line.ranges * beams[:, 2]
    low = (beams[:, 2] < -0.3) & np.isfinite(line.ranges) & (line.ranges > 0.25)
    assert np.count_nonzero(low) > 30
    assert np.median(heights[low]) == pytest.approx(0.0, abs=0.02)
