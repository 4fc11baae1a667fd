import numpy as np
import pytest

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.types import UNMEASURED, VALID, Pose2
from scan3d_twin.devices.registry import lidar_device


def read(robot, count):
    return [robot.lidar.read_line(1.0) for _ in range(count)]


def test_spec_looks_ahead_and_upwards(robot):
    spec = robot.lidar.spec
    assert (np.diff(spec.elevations) > 0).all()
    assert spec.elevations[0] < 0 < spec.elevations[-1]
    assert np.abs(spec.elevations).min() < 1e-9
    assert 0 < spec.min_range < spec.max_range


def test_beam_times_lie_within_the_line(robot):
    spec = robot.lidar.spec
    assert spec.beam_times.shape == spec.elevations.shape
    assert spec.beam_times.min() >= 0
    assert spec.beam_times.max() < spec.line_period


def test_a_line_has_one_reading_per_beam(robot):
    line = read(robot, 1)[0]
    assert line.ranges.shape == line.codes.shape == (robot.lidar.spec.n_beams,)


def test_a_code_is_never_a_distance(robot):
    for line in read(robot, 3):
        valid = line.codes == VALID
        assert np.array_equal(valid, np.isfinite(line.ranges))
        assert valid.any()
        assert not valid.all()
        unmeasured = line.codes == UNMEASURED
        assert line.elevations is not None or not unmeasured.any()
        invalid = line.codes[~valid & ~unmeasured]
        assert ((invalid >= 0) & (invalid < 20)).all()


def test_distances_are_whole_millimetres_within_the_range(robot):
    spec = robot.lidar.spec
    for line in read(robot, 3):
        ranges = line.ranges[np.isfinite(line.ranges)]
        assert ranges.min() >= spec.min_range
        assert ranges.max() <= spec.max_range
        assert np.allclose(ranges * 1000, np.round(ranges * 1000), atol=1e-6)


def test_lines_cannot_be_written(robot):
    with pytest.raises(ValueError, match="read-only"):
        read(robot, 1)[0].ranges[0] = 1.0


def test_lines_come_in_order_each_once(robot):
    stamps = np.array([line.stamp for line in read(robot, 10)])
    turns = np.diff(stamps) / robot.lidar.spec.line_period
    assert (turns > 0.9).all()
    assert np.allclose(turns, np.round(turns), atol=0.05)


def test_most_lines_arrive(robot):
    stamps = [line.stamp for line in read(robot, 20)]
    assert stamps[-1] - stamps[0] <= 1.3 * 19 * robot.lidar.spec.line_period


def test_a_line_arrives_after_its_last_beam(robot):
    for line in read(robot, 5):
        times = robot.lidar.spec.beam_times if line.beam_times is None else line.beam_times
        assert line.stamp + times[line.codes != UNMEASURED].max() <= robot.clock.now()


def test_a_line_that_is_waited_for_is_fresh(robot):
    read(robot, 5)
    line = read(robot, 1)[0]
    assert robot.clock.now() - line.stamp <= 3 * robot.lidar.spec.line_period


def test_no_line_in_time_is_an_error_that_takes_the_time(robot):
    while True:
        try:
            robot.lidar.read_line(0.0)
        except LinkTimeoutError:
            break
    read(robot, 1)
    before = robot.clock.now()
    with pytest.raises(LinkTimeoutError, match=r"0\.01 s"):
        robot.lidar.read_line(0.01)
    assert 0.01 - 1e-9 <= robot.clock.now() - before <= 0.03


def test_only_the_last_few_unread_lines_are_kept(robot):
    robot.clock.sleep(10.0)
    period, now = robot.lidar.spec.line_period, robot.clock.now()
    backlog = []
    while True:
        try:
            backlog.append(robot.lidar.read_line(0.0))
        except LinkTimeoutError:
            break
    assert 2 <= len(backlog) <= 32
    assert now - backlog[-1].stamp <= 3 * period
    assert np.allclose(np.diff([line.stamp for line in backlog]), period, rtol=0.05)


def test_unread_lines_do_not_hold_up_the_clock(robot):
    before = robot.clock.now()
    robot.clock.sleep(3.0)
    assert robot.clock.now() - before == pytest.approx(3.0, abs=0.02)


def test_reading_does_not_move_the_robot(robot):
    read(robot, 10)
    assert robot.base.odometry().T_odom_base == Pose2()


def test_reading_services_the_base(robot):
    robot.base.set_velocity(0.0, 0.3)
    read(robot, 10)
    robot.base.set_velocity(0.0, 0.0)
    assert robot.base.odometry().T_odom_base.yaw > 0.2


def test_it_measures_what_stands_ahead(open_in, lidar_name):
    # The wall's face is at x = 1.30 m, the robot starts at x = 0, the lidar is .05 m ahead of it.
    stated = lidar_device(lidar_name).options.get("lidar", {})
    accuracy = 0.02 + 2.0 * stated.get("unit_offset", 0.0)
    robot = open_in("plain_wall")
    spec = robot.lidar.spec
    line = read(robot, 1)[0]
    elevations = spec.elevations if line.elevations is None else line.elevations
    level = (np.abs(elevations) < np.radians(20)) & (line.codes != UNMEASURED)
    assert np.count_nonzero(level) > 0.9 * np.count_nonzero(np.abs(elevations) < np.radians(20))
    ahead = line.ranges[level] * np.cos(elevations[level])
    assert np.isfinite(ahead).all()
    assert np.median(ahead) == pytest.approx(1.25, abs=accuracy)


def test_positive_elevation_is_up(open_in):
    # The floor is .30 m below the lidar: seen at -20 deg at .88 m, never at +20 deg.
    robot = open_in("plain_wall")
    line = read(robot, 1)[0]
    elevations = robot.lidar.spec.elevations if line.elevations is None else line.elevations
    elevations = np.where(line.codes == UNMEASURED, np.nan, elevations)
    down = np.nanargmin(np.abs(elevations + np.radians(20)))
    up = np.nanargmin(np.abs(elevations - np.radians(20)))
    assert line.ranges[down] == pytest.approx(0.30 / np.sin(np.radians(20)), abs=0.05)
    assert line.ranges[up] == pytest.approx(1.25 / np.cos(np.radians(20)), abs=0.05)
