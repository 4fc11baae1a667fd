"""The robot without physics: it measures what is there, and errs as eq. (2) says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.config import Config, PlanningConfig
from scan3d_twin.core.evaluate import surface_distance, true_pose
from scan3d_twin.core.types import Pose2
from scan3d_twin.sim.casters import choose_caster
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import (
    KinematicRobot,
    KinematicWorld,
    Thinning,
    thin_config,
    thin_spec,
)
from scan3d_twin.sim.scanner import lidar_spec
from scan3d_twin.sim.scene import load_scene

SCENE = load_scene("three_boxes")
CASTER = choose_caster(SCENE.model)
CONFIG = Config()
EXACT = replace(CONFIG, planning=PlanningConfig(lambda_=0.0, gamma=0.0, drift=0.0))


def robot(seed=0, config=CONFIG, twin=None):
    twin = TwinConfig.ideal() if twin is None else twin
    rng = np.random.default_rng(seed)
    return KinematicRobot(SCENE, CASTER, rng, twin, config, Thinning())


def test_its_points_lie_on_the_surface():
    moving = robot(config=EXACT)
    image = moving.observe(np.array([[0.1, 0.3]]), -0.2).image
    surface, normals = moving.truth.surface(0.01)
    # The sweep's frame in the map, by its middle line and beam.
    beam = image.spec.n_beams // 2
    line = int(np.argmin(np.abs(image.yaws[:, beam])))
    stamp = float(image.stamps[line] + image.spec.beam_times[beam])
    pose = moving.truth.pose_at(stamp) @ Pose2(0, 0, -float(image.yaws[line, beam]))
    points = pose.apply(image.points[np.isfinite(image.ranges)])
    boxes = points[(points[:, 0] < 1.1) & (points[:, 2] > 0.05) & (np.abs(points[:, 1]) < 1.1)]
    boxes = boxes[boxes[:, 0] > 0.5]
    assert len(boxes) > 500
    assert np.quantile(surface_distance(boxes, surface, normals, 0.01), 0.99) < 0.002


def test_its_moves_err_as_fitted():
    errors = []
    for seed in range(300):
        moving = robot(seed)
        start = moving.world.pose
        moving._move(Pose2(0.0, 0.8, 0.5), 0.8)
        true = start.inverse() @ moving.world.pose
        told = moving.here
        errors.append([true.x - told.x, true.y - told.y, true.yaw - told.yaw])
    spread = np.std(np.array(errors), axis=0)
    planning = CONFIG.planning
    assert spread[1] == pytest.approx(math.hypot(0.8 * planning.lambda_, 0.003), rel=0.15)
    turn = math.hypot(0.5 * planning.gamma, 0.8 * planning.drift, math.radians(0.2))
    assert spread[2] == pytest.approx(turn, rel=0.15)
    assert spread[0] == pytest.approx(0.003, rel=0.25)


def test_the_same_seed_gives_the_same_bits():
    one, two, other = (robot(seed, twin=TwinConfig()).look().image.ranges for seed in (1, 1, 2))
    assert np.array_equal(one, two, equal_nan=True)
    assert not np.array_equal(one, other, equal_nan=True)


def test_time_passes_as_with_a_real_robot():
    moving = robot()
    moving.look()
    turned = math.tau / CONFIG.sweep.look_rate
    assert turned < moving.world.time < turned + 10.0
    before = moving.world.time
    moving.observe(np.array([[0.0, 0.5]]), 0.0)
    assert 14.5 < moving.world.time - before < 22.0  # 2.5 s drive, 12 s sweep, turns


def test_the_world_remembers_where_it_was():
    world = KinematicWorld(Pose2(1.0, 2.0, 3.0))
    world.add(2.0, Pose2(1.0, 2.0, -3.0))
    assert world.base_pose(1.0).yaw == pytest.approx(-math.pi)  # the short way
    assert world.base_pose(-1.0).yaw == 3.0
    assert world.base_pose(9.0).yaw == pytest.approx(-3.0)
    assert world.scene_qpos().size == 0


def test_thinning_leaves_every_third_beam_and_fewer_points_to_ask_for():
    spec = lidar_spec("usb")
    thin = thin_spec(spec, Thinning())
    assert thin.n_beams < spec.n_beams / 3
    assert np.diff(thin.elevations) == pytest.approx(3 * (spec.elevations[1] - spec.elevations[0]))
    assert set(thin.beam_times) <= set(spec.beam_times)
    assert thin_config(CONFIG, Thinning()).target.min_points == 5


def test_a_sweep_is_placed_by_its_middle_line():
    moving = robot(config=EXACT)
    seen = moving.observe(np.array([[0.0, 0.4]]), 0.3)
    view = type("View", (), {"observation": seen})()
    placed = moving.truth.spawn.inverse() @ true_pose(view, moving.truth)
    assert placed.distance(seen.T_odom_scan) < 0.02
    assert placed.yaw == pytest.approx(0.3, abs=0.02)
