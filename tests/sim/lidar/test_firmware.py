"""Error codes: each has its cause."""

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.types import VALID
from scan3d_twin.devices.urg.device import URG04LX
from scan3d_twin.sim.config import IDEAL_ROBOT, LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.config import IDEAL_LIDAR
from scan3d_twin.sim.lidar.firmware import Light, median_of_five, read
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.robot import open_sim

NOTHING_BROKEN = ((np.empty(0, int), np.empty(0, int)), np.empty(0, int))


def codes_of(distances, power, config=IDEAL_LIDAR, broken=NOTHING_BROKEN, chance=0.5):
    """Return the codes of one line of readings."""
    distances, power = np.array([distances], float), np.array([power], float)
    one = np.ones_like(distances)
    draws = Draws(0 * one, 0 * one, chance * one)
    light = Light(distances, power, one, 0 * one)
    ranges, codes = read(light, broken, draws, np.zeros(1), config, URG04LX.sensor)
    assert np.array_equal(np.isfinite(ranges), codes == VALID)
    return codes[0].tolist()


def test_nothing_came_back():
    assert codes_of([np.inf, 1, 1], [0, 1, 1]) == [0, VALID, VALID]


def test_too_far_or_too_near():
    assert codes_of([4.0954, 4.0956, 0.0194, 0.0196, 1], [1] * 5)[:4] == [VALID, 0, 0, VALID]


def test_a_wall_beyond_what_the_sensor_can_tell_has_a_code_of_its_own():
    # A log holds distances up to 5.6 m and code 6 where a wall lies further away.
    assert codes_of([4.2, 5.59, 5.61, 9.0], [1] * 4) == [0, 0, 6, 6]


def test_weak_returns_differ_from_none():
    threshold = LidarModelConfig().threshold
    config = replace(IDEAL_LIDAR, threshold=threshold)
    powers = [1, 1, 0.9 * threshold, 0.3 * threshold, 1, 1]
    assert codes_of([1] * 6, powers, config) == [VALID, VALID, 1, 0, VALID, VALID]


def test_too_strong():
    config = replace(IDEAL_LIDAR, saturation=80)
    assert codes_of([1] * 3, [1, 1, 81], config) == [VALID, VALID, 18]


def test_a_reading_without_valid_neighbours():
    codes = codes_of([1, np.inf, 1, np.inf, 1, 1], [1, 0, 1, 0, 1, 1])
    assert codes == [VALID, 0, 7, 0, VALID, VALID]  # the first step has but one neighbour


def test_a_glitch():
    config = replace(IDEAL_LIDAR, glitch=0.2)
    assert codes_of([1] * 4, [1] * 4, config, chance=np.array([0.5, 0.9, 0.5, 0.5]))[1] == 10


FILTERED = replace(IDEAL_LIDAR, running_median=True)


def test_the_running_median_is_that_of_five_steps():
    values = np.random.default_rng(0).integers(0, 40, (7, 60)).astype(float)
    padded = np.pad(values, ((0, 0), (2, 2)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=1)
    assert np.array_equal(median_of_five(values), np.median(windows, axis=-1))
    assert np.array_equal(median_of_five(values[:, :3]).shape, (7, 3))


def test_three_steps_in_the_open_read_the_same():
    # The log: 83 % of the runs of three distances among codes are equal, 5 % of those of eight.
    line = [np.inf] * 4 + [1.0, 1.02, 1.01] + [np.inf] * 4
    one = np.ones((1, 11))
    light = Light(np.array([line]), np.isfinite([line]).astype(float), one, 0 * one)
    draws = Draws(0 * one, 0 * one, 0.5 * one)
    ranges, codes = read(light, NOTHING_BROKEN, draws, np.zeros(1), FILTERED, URG04LX.sensor)
    assert ranges[0, 4:7].tolist() == [1.02] * 3  # what was not measured counts as far away
    assert codes[0].tolist() == [0] * 4 + [VALID] * 3 + [0] * 4


def test_one_step_is_filled_in_or_taken_out():
    inf = np.inf
    assert codes_of([1] * 4 + [inf] + [1] * 4, [1] * 4 + [0] + [1] * 4, FILTERED) == [VALID] * 9
    alone = codes_of([inf] * 4 + [1] + [inf] * 4, [0] * 4 + [1] + [0] * 4, FILTERED)
    assert alone == [0] * 4 + [7] + [0] * 4
    between = codes_of([1, 1, 1, inf, 1, inf, 1, 1, 1], [1, 1, 1, 0, 1, 0, 1, 1, 1], FILTERED)
    assert between == [VALID] * 4 + [7] + [VALID] * 4


def test_dropouts_are_as_many_as_asked_for():
    config = replace(IDEAL_LIDAR, dropout=0.1)
    chance = np.random.default_rng(0).random(20_000)
    codes = codes_of([1.0] * 20_000, [1.0] * 20_000, config, chance=chance)
    lost = [codes[k] != VALID for k in range(20_000)]
    assert np.mean(lost) == pytest.approx(0.1 + 0.9 * 0.1**2, abs=0.01)


def test_a_mixed_pixel_has_the_code_of_its_mixture():
    broken = ((np.array([0, 0]), np.array([1, 2])), np.array([6, VALID]))
    assert codes_of([1] * 5, [1] * 5, broken=broken) == [VALID, 6, VALID, VALID, VALID]


RETRO = (
    '<asset><material name="tape"/></asset><custom><tuple name="retro">'
    '<element objtype="material" objname="tape" prm="70"/></tuple></custom>'
)


def level_beam(scene, config=None):
    """Return code and power of the level beam in ``scene``."""
    with open_sim(scene, 0, config or TwinConfig(errors=IDEAL_ROBOT)) as (robot, truth):
        line = robot.lidar.read_line(1.0)
        front = int(np.argmin(np.abs(robot.lidar.spec.elevations)))
        return int(line.codes[front]), float(truth.evidence().intensity[front])


def surface(distance, material="", turn=0):
    """Return a target box whose front is at ``distance`` [m]."""
    return (
        f'<geom name="target" type="box" size=".02 .6 .4" pos="{distance + 0.07} 0 .4" '
        f'euler="0 0 {turn}" {material}/>'
    )


@pytest.mark.parametrize(("distance", "code"), [(0.5, 18), (2.0, VALID)])
def test_retro_reflective_tape_blinds_the_sensor_near_by(scene_of, distance, code):
    scene = scene_of(surface(distance, 'material="tape"'), head=RETRO)
    assert level_beam(scene)[0] == code


MATERIALS = (
    '<asset><material name="chrome" metallic="1" roughness=".1" rgba=".9 .9 .9 1"/>'
    '<material name="gloss" metallic="0" roughness=".1" rgba=".9 .9 .9 1"/>'
    '<material name="matte" rgba=".9 .9 .9 1"/><material name="black" rgba=".03 .03 .03 1"/>'
    "</asset>"
)


@pytest.mark.parametrize(
    ("name", "turn", "seen"),
    [
        ("matte", 0, True),
        ("matte", 40, True),
        ("gloss", 40, True),
        ("chrome", 0, True),
        ("chrome", 40, False),
        ("black", 60, False),
    ],
)
def test_surfaces_differ_in_what_comes_back(scene_of, name, turn, seen):
    config = TwinConfig(lidar=LidarModelConfig(saturation=1e6), errors=IDEAL_ROBOT)
    distance = 3.5 if name == "black" else 1.5
    scene = scene_of(surface(distance, f'material="{name}"', turn), head=MATERIALS)
    assert (level_beam(scene, config)[0] == VALID) == seen


def test_intensity_falls_from_white_to_black(scene_of):
    levels = [
        level_beam(scene_of(surface(1.0, f'material="{name}"'), head=MATERIALS))[1]
        for name in ("gloss", "matte", "black")
    ]
    assert levels[0] > levels[1] > 5 * levels[2]
