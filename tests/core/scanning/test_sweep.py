from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from kinematic import JumpingClock, KinematicBase
from paper import paper_config, paper_sweep

from scan3d_twin.core.errors import DataLossError
from scan3d_twin.core.hal import Lidar, Robot
from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.scanning.sweep import find_missing, sweep, take_panorama
from scan3d_twin.core.types import (
    UNMEASURED,
    VALID,
    FloatArray,
    LidarSpec,
    ScanLine,
    read_only,
)
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
        # on average, as a count of the encoders is a third of what a line turns
        front = image.yaws[:, image.spec.n_beams // 2]
        rate = np.ptp(front) / np.ptp(image.stamps)
        assert rate == pytest.approx(CONFIG.sweep.yaw_rate, rel=0.05)
        turned = np.ptp(image.yaws, axis=1).mean()
        assert turned == pytest.approx(rate * image.spec.beam_times[-1], rel=0.05)


def test_lost_lines_are_scanned_again() -> None:
    twin = TwinConfig(lidar=LidarModelConfig(line_loss=0.15))
    with open_sim("three_boxes", 3, twin) as (robot, _):
        image = sweep(robot, 0.0, CONFIG, ignore).image
    front = image.yaws[:, image.spec.n_beams // 2]
    assert find_missing(front, CONFIG.sweep.width / 2, SPACING) == []
    assert len(np.unique(image.stamps)) == image.n_lines


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_sweep_goes_on_to_one_side_and_lost_lines_are_scanned_again_there(side: float) -> None:
    twin = TwinConfig(lidar=LidarModelConfig(line_loss=0.15))
    config = paper_config(sweep=paper_sweep(width=math.radians(60.0)))
    half, beyond = math.radians(8.0), side * math.radians(12.0)
    with open_sim("three_boxes", 3, twin) as (robot, _):
        seen = sweep(robot, 0.1, config, ignore, half, beyond)
    front = seen.image.yaws[:, seen.image.spec.n_beams // 2]
    ends = sorted((-side * half, side * half + beyond))
    assert seen.T_odom_scan.yaw == 0.1
    assert (front.min(), front.max()) == pytest.approx(ends, abs=1.5 * SPACING)
    assert find_missing(front - np.mean(ends), half + abs(beyond) / 2, SPACING) == []


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


class WanderingLidar:
    """A lidar without a scene whose revolutions last from 95 to 108 ms, at other angles each time.

    Every beam reads how far the base has turned when it is measured, as a distance.
    """

    def __init__(self, base: KinematicBase, clock: JumpingClock, columns: int = 1) -> None:
        self.spec = around(380, columns)
        self._base, self._clock, self._rng = base, clock, np.random.default_rng(4)
        self._start = 0.0

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        # One revolution, from a start anywhere
        start, period = self._start, float(self._rng.uniform(0.095, 0.108))
        times = np.arange(0.0, period, 0.1 / 360)
        turn = self._rng.uniform(-math.pi, math.pi) + math.tau * times / period
        angles = (turn + math.pi) % math.tau - math.pi
        self._start = start + period
        arrival = self._start + 2 * self._base.spec.sample_period
        self._clock.sleep(max(0.0, arrival - self._clock.now()))

        # What it measures
        samples = self._base.odometry_since(0.0)
        stamps = [sample.stamp for sample in samples]
        headings = np.unwrap([sample.T_odom_base.yaw for sample in samples])
        ranges = 2.0 + np.interp(start + times, stamps, headings)
        return arrange_line(self.spec, start, angles, times, ranges, np.full(len(times), VALID))


def around(n_beams: int, columns: int) -> LidarSpec:
    """Return a lidar that sees all around, on a grid of ``columns`` for each beam."""
    n = n_beams * columns
    steps = read_only(np.arange(n) - n // 2)
    return LidarSpec(steps * math.tau / n, 0.1 * (steps / n + 0.5), 0.1, 0.02, 4.0)


@pytest.mark.parametrize("columns", [1, 2])
def test_beams_that_lie_elsewhere_in_each_revolution_keep_their_angles_and_times(
    columns: int,
) -> None:
    base = KinematicBase()
    clock = JumpingClock(base)
    lidar = WanderingLidar(base, clock, columns)
    robot = Robot(base, lidar, clock)
    image = sweep(robot, 0.0, CONFIG, ignore).image
    assert image.elevations is not None
    measured = image.codes != UNMEASURED
    assert 0.85 < np.mean(measured) < 1.0
    assert 340 < measured.sum(axis=1).min() < measured.sum(axis=1).max() < 385

    # The heading of each beam is that of its own time
    assert image.yaws[measured] == pytest.approx(image.ranges[measured] - 2.0, abs=1e-9)

    # Beam j is near elevation j, where the spec has it
    off = np.abs(image.elevations - image.spec.elevations)[measured]
    assert off.max() < 2.1 * math.tau / 380

    # The spec's time of the middle beam, after the stamp, is its true time
    middle = image.spec.n_beams // 2
    front = image.yaws[:, middle]
    times = image.stamps + image.spec.beam_times[middle]
    rate = np.diff(front) / np.diff(times)
    assert np.median(np.abs(rate)) == pytest.approx(CONFIG.sweep.yaw_rate, rel=1e-6)


def test_lines_of_both_kinds_make_one_image() -> None:
    """A driver may state elevations for some lines only."""
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, _):
        own = read_only(robot.lidar.spec.elevations + 0.001)
        lidar = SometimesElsewhere(robot.lidar, own)
        image = sweep(replace(robot, lidar=lidar), 0.0, CONFIG, ignore).image
    assert image.elevations is not None
    usual = np.all(image.elevations == image.spec.elevations, axis=1)
    assert 0 < np.count_nonzero(usual) < image.n_lines
    assert np.all(image.elevations[~usual] == own)


class SometimesElsewhere:
    """A lidar of whose lines every other one has ``elevations`` of its own."""

    def __init__(self, lidar: Lidar, elevations: FloatArray) -> None:
        self.spec, self._lidar, self._elevations, self._count = lidar.spec, lidar, elevations, 0

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        line, self._count = self._lidar.read_line(timeout), self._count + 1
        return replace(line, elevations=self._elevations) if self._count % 2 else line
