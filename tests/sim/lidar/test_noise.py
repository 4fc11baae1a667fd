"""Repeatability and accuracy are separate: what averaging removes, and what it does not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.types import VALID
from scan3d_twin.sim.config import IDEAL_ROBOT, LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.config import IDEAL_LIDAR, UNFILTERED_LIDAR
from scan3d_twin.sim.lidar.noise import Draws, warm_up_error
from scan3d_twin.sim.robot import open_sim

WALL = '<geom name="target" type="box" size=".05 3 3" pos="{x} 0 2"/>'


def readings(scene, lidar, lines=250, seed=0):
    """Return the level beams of a robot that stands (lines, beams) [m]."""
    config = TwinConfig(lidar=lidar, errors=IDEAL_ROBOT)
    with open_sim(scene, seed, config) as (robot, _):
        front = int(np.argmin(np.abs(robot.lidar.spec.elevations)))
        rows = [robot.lidar.read_line(1.0).ranges for _ in range(lines)]
    return np.array(rows)[:, front - 6 : front + 7]


TURNED = '<geom name="target" type="box" size=".05 1 .8" pos="{x} 0 .3" euler="0 {tilt} 0"/>'


@pytest.mark.parametrize(
    ("distance", "tilt", "low", "high"),
    [(0.8, 0, 2.1, 3.2), (1.5, 0, 2.3, 3.2), (3.5, 0, 2.3, 5.9),
     (0.8, 45, 3.0, 4.5), (1.5, 45, 4.4, 6.7), (2.5, 45, 5.5, 9.0)],
)  # fmt: skip
def test_sigma_is_that_of_the_log(scene_of, distance, tilt, low, high):
    """The log's intervals, [mm]: 1-2 m frontally [2.3, 3.4], at 30-60 deg [4.4, 6.7]."""
    scene = scene_of(TURNED.format(x=0.05 + 0.05 / math.cos(math.radians(tilt)) + distance,
                                   tilt=tilt))  # fmt: skip
    sigma = readings(scene, LidarModelConfig(), 400)
    assert low < 1000 * np.nanmedian(np.nanstd(sigma, axis=0)) < high


def correlations(rows, lags=(1, 2, 3)):
    """Return the correlation along the beams of ``rows`` (lines, beams)."""
    off = rows - np.nanmean(rows, axis=0)
    return [np.nanmean(off[:, k:] * off[:, :-k]) / np.nanvar(off) for k in lags]


@pytest.mark.parametrize(
    ("tilt", "low", "high"),
    [(0, (0.6, 0.4, 0.2), (0.8, 0.65, 0.45)), (45, (0.2, -0.05, -0.1), (0.5, 0.25, 0.15))],
)
def test_correlation_along_the_beams(scene_of, tilt, low, high):
    """The log: .69 .47 on walls that recede by less than 1 mm a step, .32 .08 by 8 to 12 mm."""
    rows = readings(scene_of(TURNED.format(x=1.6, tilt=tilt)), LidarModelConfig(), 400)
    found = correlations(rows)
    assert np.all(np.array(low) < found)
    assert np.all(found < np.array(high))


def test_averaging_leaves_the_bias(scene_of):
    scene = scene_of(WALL.format(x=1.3))
    means = [np.nanmean(readings(scene, LidarModelConfig(), 100, seed)) for seed in range(12)]
    truth = 1.2
    assert abs(np.mean(means) - truth) < 0.009
    assert 0.001 < np.std(means) < 0.006  # of surfaces: 3 mm


def test_a_surface_keeps_its_bias(scene_of):
    lidar = replace(IDEAL_LIDAR, surface_bias=0.01)
    scene = scene_of(WALL.format(x=1.3))
    first, second = (readings(scene, lidar, 3, seed=4) for _ in range(2))
    assert np.array_equal(first, second)
    assert np.ptp(first - first[0]) == 0


def test_the_cold_sensor_drifts_until_it_is_warm():
    config = LidarModelConfig()
    drift = [warm_up_error(time, config) for time in (0.0, 1200.0, 1e5)]
    assert drift[0] == config.warm_up
    assert drift[1] == pytest.approx(config.warm_up / np.e)
    assert drift[2] < 1e-9


def test_neighbouring_steps_share_noise():
    rngs = [np.random.default_rng([1, k]) for k in range(40)]
    noise = Draws.of(rngs, 682, LidarModelConfig(neighbours=0.4)).noise
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    lags = [(noise[:, k:] * noise[:, : noise.shape[1] - k]).mean() for k in (1, 2, 3)]
    assert lags == pytest.approx([0.4, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize(
    ("tilt", "low", "high"), [(0, 0.42, 0.56), (20, 0.2, 0.38), (45, 0.02, 0.2)]
)
def test_share_of_equal_neighbours(scene_of, tilt, low, high):
    """The log: .50 on walls that recede by under 1 mm a step, .32 by 3 mm, .11 by 10 mm."""
    scene = scene_of(TURNED.format(x=1.5, tilt=tilt))
    rows = readings(scene, LidarModelConfig(), 300)
    pairs = np.diff(rows, axis=1)
    assert low < (np.abs(pairs) < 1e-6).sum() / np.isfinite(pairs).sum() < high


def test_the_world_unfiltered_has_the_noise_of_older_figures(scene_of):
    """Up to e3444ed: almost twice the noise of the log, and fewer equal neighbours."""
    rows = {
        (x, tilt): readings(scene_of(TURNED.format(x=x + 0.1, tilt=tilt)), UNFILTERED_LIDAR, 300)
        for x, tilt in ((1.5, 0), (3.5, 0), (1.5, 45))
    }
    sigma = {key: 1000 * np.nanstd(values, axis=0).mean() for key, values in rows.items()}
    assert list(sigma.values()) == pytest.approx([4.8, 7.1, 7.5], abs=0.4)
    flat = rows[1.5, 0]
    assert 0.15 < (np.abs(np.diff(flat, axis=1)) < 1e-6).mean() < 0.30
    assert correlations(flat)[2] == pytest.approx(0.0, abs=0.06)


EDGE = (
    '<geom name="target" type="box" size=".05 3 .25" pos="1.1 0 .25"/>'
    '<geom name="back" type="box" size=".05 3 3" pos="2.1 0 2"/>'
)


def test_edges_flicker_by_about_a_step(scene_of):
    """The log: where a surface ends, in 85 % of the lines a step more or less is valid."""

    def moves(lidar):
        """Return the mean number of steps that change sides at the edge from line to line."""
        with open_sim(scene_of(EDGE), 0, TwinConfig(lidar=lidar, errors=IDEAL_ROBOT)) as (robot, _):
            rows = np.array([robot.lidar.read_line(1.0).ranges for _ in range(120)])
            edge = np.abs(robot.lidar.spec.elevations - math.atan2(0.2, 1.0)) < 0.2
        near = rows[:, edge] < 1.5
        return (near[1:] != near[:-1]).sum(axis=1).mean()

    typical = LidarModelConfig()
    assert 0.3 < moves(typical) < 2.0
    assert moves(replace(typical, pointing=0.0)) < 0.3


def test_pointing_errs_by_range_where_a_wall_is_seen_at_an_angle(scene_of):
    lidar = replace(IDEAL_LIDAR, pointing=0.003)
    sigma = {}
    for tilt in (0, 45):
        rows = readings(scene_of(TURNED.format(x=1.5, tilt=tilt)), lidar, 400)
        middle = rows[:, 6]
        sigma[tilt] = middle.std(), middle.mean()
    assert sigma[0][0] < 0.0005
    spread, distance = sigma[45]
    assert spread == pytest.approx(0.003 * distance, rel=0.15)  # r tan(45 deg) times the error


def test_a_repeat_never_bridges_an_edge(scene_of):
    lidar = replace(IDEAL_LIDAR, repeats=0.9, sigma=0.004)
    body = WALL.format(x=1.5) + '<geom name="post" type="box" size=".05 3 .25" pos="1.05 0 .25"/>'
    config = TwinConfig(lidar=lidar, errors=IDEAL_ROBOT)
    with open_sim(scene_of(body), 0, config) as (robot, truth):
        for _ in range(20):
            line = robot.lidar.read_line(1.0)
            distances = truth.evidence().distances
            valid = line.codes == VALID
            assert np.abs(line.ranges - distances)[valid].max() < 0.1
