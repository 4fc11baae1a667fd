from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_sweep

from scan3d_twin.core.errors import DataLossError
from scan3d_twin.core.scanning.sweep import find_missing, sweep, take_panorama
from scan3d_twin.core.types import ScanLine
from scan3d_twin.sim.config import LidarModelConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim

CONFIG = paper_config(sweep=paper_sweep(width=math.radians(30.0)))
SPACING = CONFIG.sweep.yaw_rate * 0.1


def ignore(line: ScanLine) -> None:
    """Take no notice of a line."""


def test_nothing_is_missing_from_a_regular_sweep() -> None:
    yaws = np.arange(-10, 11) * SPACING
    assert find_missing(yaws, 10 * SPACING, SPACING) == []
    assert find_missing(yaws[::-1], 10 * SPACING, SPACING) == []


def test_a_lost_line_and_a_lost_end_are_found() -> None:
    yaws = np.delete(np.arange(-10, 11) * SPACING, [5, 19, 20])
    (left, right), (a, b) = sorted(find_missing(yaws, 10 * SPACING, SPACING), reverse=True)
    assert left > 9 * SPACING > 8.9 * SPACING > right == pytest.approx(8 * SPACING)
    assert (a, b) == pytest.approx((-4 * SPACING, -6 * SPACING))


def test_a_sweep_covers_its_width_left_to_right_around_the_heading() -> None:
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, truth):
        observation = sweep(robot, 0.2, CONFIG, ignore)
        image = observation.image
        front = image.yaws[:, image.spec.n_beams // 2]
        assert np.all(np.diff(front) < 0)
        assert front[0] == pytest.approx(CONFIG.sweep.width / 2, abs=SPACING)
        assert front[-1] == pytest.approx(-CONFIG.sweep.width / 2, abs=SPACING)
        assert observation.T_odom_scan.yaw == 0.2
        middle = int(np.argmin(np.abs(front)))
        stamp = image.stamps[middle] + image.spec.beam_times[image.spec.n_beams // 2]
        assert truth.pose_at(stamp).yaw == pytest.approx(0.2 + front[middle], abs=0.005)


def test_every_beam_has_the_heading_of_its_own_time() -> None:
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, truth):
        image = sweep(robot, 0.0, CONFIG, ignore).image
        beams = np.array([0, 200, 500, image.spec.n_beams - 1])
        for line in (5, 30, 55):
            stamps = image.stamps[line] + image.spec.beam_times[beams]
            true = [truth.pose_at(float(stamp)).yaw for stamp in stamps]
            assert image.yaws[line, beams] == pytest.approx(true, abs=0.004)
            assert np.ptp(image.yaws[line]) == pytest.approx(
                CONFIG.sweep.yaw_rate * image.spec.beam_times[-1], rel=0.3
            )


def test_lost_lines_are_scanned_again() -> None:
    twin = TwinConfig(lidar=LidarModelConfig(line_loss=0.15))
    with open_sim("three_boxes", 3, twin) as (robot, _):
        image = sweep(robot, 0.0, CONFIG, ignore).image
    front = image.yaws[:, image.spec.n_beams // 2]
    assert find_missing(front, CONFIG.sweep.width / 2, SPACING) == []
    assert len(np.unique(image.stamps)) == image.n_lines


def test_a_lidar_that_loses_too_much_is_an_error_and_the_robot_stands() -> None:
    twin = TwinConfig(lidar=LidarModelConfig(line_loss=0.6))
    config = replace(CONFIG, sweep=replace(CONFIG.sweep, retries=0))
    with open_sim("three_boxes", 3, twin) as (robot, _):
        with pytest.raises(DataLossError, match=r"gaps in the sweep are left after 0 more passes"):
            sweep(robot, 0.0, config, ignore)
        here = robot.base.odometry().T_odom_base
        robot.clock.sleep(0.5)
        assert robot.base.odometry().T_odom_base.distance(here) < 0.002


def test_a_look_around_sees_all_round_and_comes_back() -> None:
    with open_sim("three_boxes", 0) as (robot, truth):
        before = truth.pose_at(robot.clock.now()).yaw
        observation = take_panorama(robot, CONFIG, ignore)
        after = truth.pose_at(robot.clock.now()).yaw
    front = observation.image.yaws[:, observation.image.spec.n_beams // 2]
    assert np.ptp(front) >= math.tau
    assert np.abs(np.diff(front)).max() < math.radians(2.5)
    assert after == pytest.approx(before, abs=math.radians(1.5))  # the error of the base cancels


def test_observers_see_every_line() -> None:
    seen: list[ScanLine] = []
    with open_sim("three_boxes", 0) as (robot, _):
        image = sweep(robot, 0.0, CONFIG, seen.append).image
    assert {float(stamp) for stamp in image.stamps} <= {line.stamp for line in seen}
