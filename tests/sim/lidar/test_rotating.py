"""The twin's lidar that turns all round and measures by a clock of its own."""

from __future__ import annotations

import math

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.core.hal import BeamStream
from scan3d_twin.core.types import UNMEASURED, VALID, Beams, ScanLine
from scan3d_twin.devices.ldrobot.model import LD19
from scan3d_twin.devices.rotating import list_beams
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.rotating import RotatingLidar

TYPICAL = s3d.TwinConfig.of("typical", lidar="ld19")


def read(count: int, config: s3d.TwinConfig = TYPICAL, seed: int = 5) -> list[ScanLine]:
    with s3d.open_sim("plain_wall", seed, config) as (robot, _):
        return [robot.lidar.read_line(1.0) for _ in range(count)]


def test_no_reading_is_lost_and_none_is_made_up() -> None:
    parts = [list_beams(line, LD19.spec) for line in read(30)]
    assert len({len(part) for part in parts}) > 2  # the turns wander
    numbers = np.concatenate([part.times for part in parts]) * LD19.sample_rate
    # Stamps are cut to milliseconds, and each line begins where the one before ended
    steps = np.diff(numbers)
    assert np.all(np.abs(steps - 1) < 5.0)
    assert sum(map(len, parts)) == pytest.approx(numbers[-1] - numbers[0] + 1, abs=5.0)


def test_a_revolution_begins_behind_and_turns_evenly_over_the_floor() -> None:
    for line in read(5):
        assert line.elevations is not None
        assert line.beam_times is not None
        there = line.codes != UNMEASURED
        share = (line.elevations[there] + math.pi) / math.tau
        period = np.polyfit(share, line.beam_times[there], 1)
        assert period == pytest.approx([0.1, 0.0], abs=2e-3)
        assert np.allclose(np.polyval(period, share), line.beam_times[there], atol=1e-9)


def test_angles_lie_elsewhere_in_each_revolution() -> None:
    first, second, *_ = read(3)
    assert first.elevations is not None
    assert second.elevations is not None
    both = (first.codes != UNMEASURED) & (second.codes != UNMEASURED)
    step = math.tau / LD19.readings
    assert np.median(np.abs(first.elevations - second.elevations)[both]) > 0.02 * step


def test_it_sees_ahead_overhead_and_behind() -> None:
    ideal = s3d.TwinConfig.of("ideal", lidar="ld19")
    with s3d.open_sim("three_boxes", 0, ideal) as (robot, truth):
        line = robot.lidar.read_line(1.0)
        evidence = truth.evidence()
    assert evidence is not None
    assert line.elevations is not None
    back = (np.abs(line.elevations) > math.radians(120)) & (line.codes == VALID)
    assert np.count_nonzero(back) > 50
    valid = line.codes == VALID
    assert np.allclose(line.ranges[valid], evidence.distances[valid], atol=6e-4)
    elevations = np.arctan2(evidence.directions[:, 2], np.hypot(*evidence.directions[:, :2].T))
    assert np.allclose(np.sin(elevations[valid]), np.sin(line.elevations[valid]), atol=2e-3)


def test_beams_read_as_they_are_measured_are_those_of_the_lines() -> None:
    with s3d.open_sim("plain_wall", 5, TYPICAL) as (robot, _):
        lidar = robot.lidar
        assert isinstance(lidar, BeamStream)
        parts = []
        while robot.clock.now() < 0.8:
            robot.clock.sleep(0.006)
            parts.append(lidar.read_beams())
            if len(parts[-1]):
                assert parts[-1].times[-1] <= robot.clock.now()
        streamed = Beams.join(parts)
        lines = [lidar.read_line(1.0) for _ in range(5)]
    assert np.all(np.diff(streamed.times) > 0)
    for line in lines[1:]:
        beams = list_beams(line, lidar.spec)
        first = int(np.argmin(np.abs(streamed.times - beams.times[0] - 0.0005)))
        for shift in range(-5, 6):
            part = streamed.select(slice(first + shift, first + shift + len(beams)))
            if np.array_equal(part.ranges, beams.ranges, equal_nan=True):
                break
        assert np.array_equal(part.ranges, beams.ranges, equal_nan=True)
        assert np.allclose(part.elevations, beams.elevations, atol=1e-12)
        assert np.allclose(part.times - part.times[0], beams.times - beams.times[0], atol=1e-12)


def test_the_same_seed_gives_the_same_bits() -> None:
    for a, b in zip(read(3), read(3), strict=True):
        assert a.stamp == b.stamp
        for name in ("ranges", "codes", "elevations", "beam_times"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert read(1, seed=6)[0].ranges.tobytes() != read(1)[0].ranges.tobytes()


def test_beams_that_nobody_reads_are_not_kept_for_ever() -> None:
    with s3d.open_sim("plain_wall", 5, TYPICAL) as (robot, _):
        assert isinstance(robot.lidar, BeamStream)
        robot.clock.sleep(6.0)
        late = robot.lidar.read_beams()
        assert len(robot.lidar.read_beams()) == 0
    assert 1.0 < late.times[-1] - late.times[0] < 3.5
    assert late.times[-1] > 5.99


def test_beams_of_which_none_passes_the_robot_are_read() -> None:
    """A few beams that look down, as an emulator asks for them."""
    with s3d.open_sim("plain_wall", 5, TYPICAL) as (robot, _):
        lidar = robot.lidar
        assert isinstance(lidar, RotatingLidar)
        scanner = lidar._scanner
        fan = scanner.make_fan(np.radians([-92.0, -90.0, -88.0]))
        draws = Draws.of([np.random.default_rng(0)], 3, scanner.config)
        at = np.zeros((1, 3, 3)), np.broadcast_to(np.eye(3), (1, 3, 3, 3))
        readings = scanner.measure(np.empty(0), *at, draws, np.zeros(1), fan=fan, evidence=True)
    assert np.all(readings.codes == VALID)
    assert 0.1 < readings.ranges.min() < readings.ranges.max() < 0.35
    assert np.all(readings.evidence[0].geoms == -1)


def test_each_sensor_has_an_offset_of_its_own_that_stays() -> None:
    found = []
    for seed in range(1, 5):
        with s3d.open_sim("plain_wall", seed, TYPICAL) as (robot, truth):
            for _ in range(2):
                lines = [robot.lidar.read_line(1.0) for _ in range(3)]
                evidence = truth.evidence()
                assert evidence is not None
                line = lines[-1]
                ahead = (np.abs(line.elevations) < 0.4) & (line.codes == VALID)
                found.append(float(np.mean(line.ranges[ahead] - evidence.distances[ahead])))
                robot.clock.sleep(2.0)
    first, later = np.array(found[::2]), np.array(found[1::2])
    assert np.allclose(first, later, atol=0.006)
    assert 0.005 < np.std(first) < 0.05
    assert np.min(first) < 0 < np.max(first)
