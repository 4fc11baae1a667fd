import math
from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.errors import ConfigError, LinkTimeoutError
from scan3d_twin.core.types import VALID
from scan3d_twin.devices.urg.lines import link_spec
from scan3d_twin.sim.config import IDEAL_ROBOT, LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.scanner import CHUNK, beam_directions, own_housing
from scan3d_twin.sim.robot import open_sim

MOUNT = np.array([0.05, 0.0, 0.30])


def drain(robot):
    """Forget the unread lines."""
    one_by_one(robot)


def expected(robot, truth, stamps):
    """Noise-free distances of each beam, seen from the true base pose at its time (n_beams,)."""
    origins, directions = [], []
    beams = beam_directions(robot.lidar.spec.elevations)
    for beam, stamp in zip(beams, stamps, strict=True):
        pose = truth.pose_at(stamp)
        origins.append(pose.apply(MOUNT))
        directions.append(pose.rotate(beam))
    return truth.first_hits(np.array(origins), np.array(directions))


def one_by_one(robot):
    """Return the unread lines."""
    lines = []
    while True:
        try:
            lines.append(robot.lidar.read_line(0.0))
        except LinkTimeoutError:
            return lines


@pytest.mark.parametrize(
    ("link", "count", "period"),
    [("usb", 682, 0.1), ("115200", 357, 0.1), ("115200-full", 682, 0.2)],
)
def test_the_link_decides_what_comes(link, count, period):
    with open_sim("plain_wall", 0, TwinConfig.ideal(link)) as (robot, _):
        first, second = robot.lidar.read_line(1.0), robot.lidar.read_line(1.0)
    assert first.ranges.shape == (count,)
    assert second.stamp - first.stamp == pytest.approx(period)
    assert link_spec(link).line_period == period


def test_each_beam_is_measured_from_its_own_pose():
    rate = math.radians(40)
    with open_sim("plain_wall", 0, TwinConfig.ideal()) as (robot, truth):
        robot.base.set_velocity(0.0, -rate)
        robot.clock.sleep(0.6)
        drain(robot)
        line = robot.lidar.read_line(1.0)
        spec = robot.lidar.spec
        own = expected(robot, truth, line.stamp + spec.beam_times)
        frozen = expected(robot, truth, np.full(spec.n_beams, line.stamp))
        turned = truth.pose_at(line.stamp + spec.beam_times[-1]).yaw - truth.pose_at(line.stamp).yaw
    wall = (np.abs(spec.elevations) < math.radians(12)) & np.isfinite(line.ranges)
    assert wall.sum() > 50
    error = np.abs(line.ranges - own)[wall]
    assert error.max() < 0.004
    assert np.abs(line.ranges - frozen)[wall].mean() > 5 * error.mean()
    # The fan is skewed by omega * t: 40 deg/s for the 70.8 ms from step 0 to step 725.
    assert turned == pytest.approx(-rate * 725 / 1024 * 0.1, rel=0.03)


def test_skew_of_a_point_is_omega_t_r():
    rate = math.radians(20)
    with open_sim("plain_wall", 0, TwinConfig.ideal()) as (robot, _):
        _, sent = robot.base.set_velocity(0.0, rate)
        robot.clock.sleep(0.5)
        drain(robot)
        line = robot.lidar.read_line(1.0)
        spec, world = robot.lidar.spec, robot.base._world
        _, rotations = world.lidar_poses(line.stamp + spec.beam_times)
        _, start = world.lidar_poses(np.array([line.stamp]))
        beams = beam_directions(spec.elevations)
        moved = np.einsum("nij,nj->ni", rotations, beams) - beams @ start[0].T
        frozen_error = np.linalg.norm(moved, axis=1)
    analytic = sent * spec.beam_times * np.abs(np.cos(spec.elevations))
    assert frozen_error == pytest.approx(analytic, abs=0.001)
    assert analytic.max() > 0.010


def test_an_ideal_lidar_errs_by_its_millimetre():
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, truth):
        line = robot.lidar.read_line(1.0)
        distances = expected(robot, truth, line.stamp + robot.lidar.spec.beam_times)
    ahead = np.abs(robot.lidar.spec.elevations) < math.radians(3)
    assert np.isfinite(line.ranges[ahead]).all()
    assert np.abs(line.ranges - distances)[ahead].max() < 0.0015


def test_noise_at_normal_incidence_is_that_of_the_log():
    # Standing lines of a real sensor, 1 to 2 m, 0 to 30 deg: 2.65 mm [2.3, 3.4].
    with open_sim("plain_wall", 0) as (robot, _):
        front = np.argmin(np.abs(robot.lidar.spec.elevations))
        ranges = np.array([robot.lidar.read_line(1.0).ranges for _ in range(200)])
    sigma = np.nanstd(ranges[:, front - 20 : front + 20], axis=0).mean() * 1000
    assert 2.3 < sigma < 3.0


def test_noise_is_white_over_lines():
    with open_sim("plain_wall", 0) as (robot, _):
        front = np.argmin(np.abs(robot.lidar.spec.elevations))
        values = [robot.lidar.read_line(1.0).ranges[front] for _ in range(300)]
    deviation = np.array(values) - np.nanmean(values)
    assert np.mean(np.isfinite(deviation)) > 0.98
    products = np.nanmean(deviation[1:] * deviation[:-1])
    assert abs(products / np.nanvar(deviation)) < 0.2


def test_beyond_the_range_there_is_a_code_and_no_distance():
    with open_sim("plain_wall", 0, TwinConfig.ideal()) as (robot, _):
        line = robot.lidar.read_line(1.0)
        up = robot.lidar.spec.elevations > math.radians(80)
    assert (line.codes[up] == 0).all()
    assert np.isnan(line.ranges[up]).all()


@pytest.mark.parametrize(("distance", "seen"), [(4.03, True), (4.20, False)])
def test_distances_end_at_4095_mm(scene_of, distance, seen):
    wall = f'<geom name="target" type="box" size=".1 2 2" pos="{0.15 + distance} 0 2"/>'
    with open_sim(scene_of(wall), 0, TwinConfig.ideal()) as (robot, _):
        line = robot.lidar.read_line(1.0)
        front = np.argmin(np.abs(robot.lidar.spec.elevations))
    assert (line.codes[front] == VALID) == seen
    assert np.isfinite(line.ranges[front]) == seen


def test_it_sees_its_own_deck_below():
    spec = link_spec("usb")
    own = own_housing("create2", spec.elevations)
    below = np.argmin(np.abs(spec.elevations + math.pi / 2))
    assert 0.15 < own.distances[below] < 0.25
    assert own.normals[below] == pytest.approx([0, 0, 1], abs=1e-9)
    assert np.isinf(own.distances[spec.elevations > math.radians(-55)]).all()
    with open_sim("plain_wall", 0, TwinConfig.ideal()) as (robot, _):
        line = robot.lidar.read_line(1.0)
    seen = np.isfinite(own.distances)
    assert line.ranges[seen] == pytest.approx(own.distances[seen], abs=0.001)


def test_lost_lines_leave_a_gap_of_a_whole_period():
    config = TwinConfig(lidar=LidarModelConfig(line_loss=0.3, period_error=0.0, revolution=0.0))
    with open_sim("plain_wall", 0, config) as (robot, _):
        stamps = np.array([robot.lidar.read_line(2.0).stamp for _ in range(140)])
    turns = np.diff(stamps) / 0.1
    assert turns == pytest.approx(np.round(turns), abs=0.05)
    turns = np.round(turns)
    assert 139 / turns.sum() == pytest.approx(0.7, abs=0.1)


def test_losing_lines_does_not_change_the_others():
    def read(loss):
        config = TwinConfig(lidar=LidarModelConfig(line_loss=loss))
        with open_sim("plain_wall", 0, config) as (robot, _):
            lines = [robot.lidar.read_line(2.0) for _ in range(20)]
        return {line.stamp: line.ranges for line in lines}

    whole, lossy = read(0.0), read(0.3)
    common = sorted(set(whole) & set(lossy))
    assert 5 < len(common) < 20
    for stamp in common:
        assert np.array_equal(whole[stamp], lossy[stamp], equal_nan=True)


CYLINDER = (
    '<asset><material name="metal" metallic="1" roughness="{roughness}"/></asset>',
    '<geom name="target" type="cylinder" size=".15 .3" pos="1.25 0 .3" material="metal"/>',
)


def strip(scene_of, roughness):
    """Return the share of beams on a metal cylinder 1.2 m away that is lost, and the width of what
    the level beam sees of it [deg]."""
    head, body = CYLINDER
    scene = scene_of(body, head=head.format(roughness=roughness))
    with open_sim(scene, 0, TwinConfig(errors=IDEAL_ROBOT)) as (robot, truth):
        robot.base.set_velocity(0.0, math.radians(-10))
        robot.clock.sleep(1.2)
        robot.base.set_velocity(0.0, math.radians(5))
        robot.clock.sleep(0.5)
        drain(robot)
        spec, yaws, on, back = robot.lidar.spec, [], [], []
        for _ in range(50):
            line = robot.lidar.read_line(1.0)
            stamps = line.stamp + spec.beam_times
            distances = expected(robot, truth, stamps)
            level = np.abs(spec.elevations) < math.radians(12)
            on.append(level & (distances < 1.4))
            back.append(on[-1] & np.isfinite(line.ranges))
            yaws.append(math.degrees(truth.pose_at(stamps[len(stamps) // 2]).yaw))
    front = np.argmin(np.abs(spec.elevations))
    seen = np.array(yaws)[np.array(back)[:, front]]
    return 1 - np.sum(back) / np.sum(on), float(np.ptp(seen)) if len(seen) else 0.0


@pytest.mark.parametrize(
    ("roughness", "low", "high"),
    [(0.05, 0.85, 0.99), (0.1, 0.70, 0.92), (0.2, 0.40, 0.65), (0.3, 0.05, 0.25), (0.5, 0, 0.01)],
)
def test_a_chrome_cylinder_keeps_only_the_strip_that_faces_the_lidar(
    scene_of, roughness, low, high
):
    lost, width = strip(scene_of, roughness)
    assert low <= lost <= high
    assert width == pytest.approx(14.1 * (1 - lost), abs=3.0)
    assert width > 0.4


def test_the_time_of_the_first_line_is_drawn_from_the_seed():
    starts = set()
    for seed in range(5):
        with open_sim("plain_wall", seed) as (robot, _):
            starts.add(robot.lidar.read_line(1.0).stamp)
    assert len(starts) == 5
    assert all(0 <= start < 0.1 for start in starts)


@pytest.mark.parametrize("rays", [1, 5])
@pytest.mark.parametrize("scene", ["three_boxes", "shiny_cylinder"])
def test_a_sweep_at_once_equals_one_line_by_line(scene, rays):
    def read(at_once):
        config = TwinConfig(lidar=LidarModelConfig(sub_rays=rays, line_loss=0.1))
        with open_sim(scene, 3, config) as (robot, _):
            robot.base.set_velocity(0.0, math.radians(10))
            if at_once:
                return robot.lidar.read_sweep(21)
            return [robot.lidar.read_line(1.0) for _ in range(21)]

    for one, other in zip(read(True), read(False), strict=True):
        assert one.stamp == other.stamp
        assert np.array_equal(one.ranges, other.ranges, equal_nan=True)
        assert np.array_equal(one.codes, other.codes)


def test_a_sweep_at_once_is_as_long_as_the_poses_are_kept():
    with (
        open_sim("plain_wall", 0) as (robot, _),
        pytest.raises(ConfigError, match=r"1 to 29\d lines, got 400"),
    ):
        robot.lidar.read_sweep(400)


def test_revolutions_jitter_and_stamps_are_whole_milliseconds():
    config = TwinConfig(lidar=LidarModelConfig(revolution=0.0))
    period = 0.1 * (1 + config.lidar.period_error)
    with open_sim("plain_wall", 1, config) as (robot, _):
        stamps = np.array([robot.lidar.read_line(1.0).stamp for _ in range(300)])
    assert stamps * 1000 == pytest.approx(np.round(stamps * 1000), abs=1e-6)
    # Jitter of .3 ms at both ends and rounding to 1 ms: sqrt(2 * (.3^2 + 1 / 12)).
    assert 1000 * np.diff(stamps).std() == pytest.approx(0.59, abs=0.12)
    assert np.diff(stamps).mean() == pytest.approx(period, abs=1e-4)


def test_each_sensor_has_its_own_pace():
    def period(seed):
        with open_sim("plain_wall", seed) as (robot, _):
            robot.clock.sleep(0.5)
            first = robot.lidar.read_line(1.0).stamp
            for _ in range(20):
                last = robot.lidar.read_line(1.0).stamp
        return (last - first) / 20

    periods = np.array([period(seed) for seed in range(8)])
    assert 0.0001 < periods.std() < 0.0009
    assert periods.mean() == pytest.approx(0.0988, abs=0.0006)  # the log: 98.8 ms


@pytest.mark.parametrize("latency", [0.085, 0.101, 0.3])
def test_a_line_arrives_after_its_latency(latency):
    config = TwinConfig(lidar=LidarModelConfig(latency=latency, jitter=0.0, stamp_step=0.0))
    with open_sim("plain_wall", 0, config) as (robot, _):
        for _ in range(5):
            line = robot.lidar.read_line(1.0)
            assert 0 <= robot.clock.now() - line.stamp - latency < 0.0021


def test_the_evidence_behind_a_line():
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, truth):
        assert truth.evidence() is None
        line = robot.lidar.read_line(1.0)
        evidence = truth.evidence()
        names = [truth._scene.model.geom(k).name if k >= 0 else "" for k in evidence.geoms]
    valid = line.codes == VALID
    assert line.ranges[valid] == pytest.approx(evidence.distances[valid], abs=0.0006)
    assert {"floor", "target_middle", ""} <= set(names)
    hit = evidence.geoms >= 0
    assert np.linalg.norm(evidence.normals[hit], axis=1) == pytest.approx(1.0)
    assert evidence.positions[0] == pytest.approx([-0.85, 0, 0.3], abs=0.001)
    assert np.linalg.norm(evidence.directions, axis=1) == pytest.approx(1.0)
    assert (evidence.intensity[valid] > 0).all()


@pytest.mark.parametrize("latency", [LidarModelConfig().latency, 0.08])
def test_lines_that_wait_are_the_same_bits_as_lines_read_one_by_one(latency):
    twin = replace(TwinConfig(), lidar=replace(LidarModelConfig(), latency=latency))

    def as_they_come(robot):
        return [robot.lidar.read_line(1.0) for _ in range(len(waiting))]

    def lines_of(read, seconds):
        with open_sim("three_boxes", 4, twin) as (robot, _):
            robot.base.set_velocity(0.0, math.radians(20))
            robot.clock.sleep(seconds)
            return read(robot)

    waiting = lines_of(lambda robot: robot.lidar.read_waiting(), 1.45)
    assert len(waiting) > CHUNK
    assert not np.array_equal(waiting[0].ranges, waiting[-1].ranges, equal_nan=True)
    for single in (lines_of(one_by_one, 1.45), lines_of(as_they_come, 0.0)):
        assert [line.stamp for line in single] == [line.stamp for line in waiting]
        for a, b in zip(waiting, single, strict=True):
            assert np.array_equal(a.ranges, b.ranges, equal_nan=True)
            assert np.array_equal(a.codes, b.codes)
