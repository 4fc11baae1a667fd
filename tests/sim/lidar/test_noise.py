"""Repeatability and accuracy are separate: what averaging removes, and what it does not."""

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.types import VALID
from scan3d_twin.sim.config import IDEAL_ROBOT, LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.config import IDEAL_LIDAR
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


@pytest.mark.parametrize(
    ("distance", "low", "high"),
    [(0.5, 4.0, 5.5), (1.2, 4.0, 5.5), (1.9, 4.0, 5.5), (2.5, 6.5, 7.5), (3.8, 6.5, 7.5)],
)
def test_sigma_at_normal_incidence_is_that_of_real_logs(scene_of, distance, low, high):
    # Robust sigma of real logs: 4.2 to 5.2 mm at .5 to 2 m, 6.8 to 7.3 mm at 2 to 4 m.
    scene = scene_of(WALL.format(x=0.05 + 0.05 + distance))
    sigma = readings(scene, LidarModelConfig(), 500)
    sigma = 1000 * np.nanstd(sigma, axis=0).mean()
    assert low < sigma < high


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


def test_share_of_equal_neighbours(scene_of):
    """Independent noise of 4.6 mm repeats a millimetre in 6 %; a capture holds 26 to 34 %."""

    def share(lidar):
        """Return the share of readings that repeat the one before."""
        rows = readings(scene_of(WALL.format(x=1.3)), lidar, 200)
        return (np.abs(np.diff(rows, axis=1)) < 1e-6).mean()

    assert share(LidarModelConfig(neighbours=0.0, repeats=0.0)) == pytest.approx(0.06, abs=0.02)
    assert 0.15 < share(LidarModelConfig()) < 0.30


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
