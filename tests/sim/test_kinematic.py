"""The robot without physics: it measures what is there, and errs as the one with physics does."""

import math

import numpy as np
import pytest
from paper import paper_config

from scan3d_twin.core.model.pose_errors import find_true_pose
from scan3d_twin.core.model.sampled_surface import measure_surface_distance
from scan3d_twin.core.navigation.motion_control import drive_to, turn_to
from scan3d_twin.core.types import Pose2, wrap
from scan3d_twin.devices.create.model import CREATE2
from scan3d_twin.devices.urg.lines import link_spec
from scan3d_twin.sim.base.motion_errors import (
    SLIP_XY,
    SLIP_YAW,
    TURN_CREEP,
    apply_motion_errors,
)
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import (
    KinematicRobot,
    KinematicWorld,
    Thinning,
    thin_config,
    thin_spec,
)
from scan3d_twin.sim.ray_casting import choose_caster
from scan3d_twin.sim.robot import draw_robot, open_sim
from scan3d_twin.sim.scenes.load import load_scene

SCENE = load_scene("three_boxes")
CASTER = choose_caster(SCENE.model)
CONFIG = paper_config()


def robot(seed=0, twin=None):
    """Return a kinematic robot, by default without errors."""
    twin = TwinConfig.ideal() if twin is None else twin
    return KinematicRobot(SCENE, CASTER, seed, twin, CONFIG, Thinning())


def test_its_points_lie_on_the_surface():
    moving = robot()
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
    # Creep turns half a sweep by 2 mm at 1 m.
    assert np.quantile(measure_surface_distance(boxes, surface, normals, 0.01), 0.99) < 0.003


def test_one_robot_errs_alike_in_all_its_moves():
    """Two wheels of two sizes bend each way to the same side."""
    bent = []
    for seed in range(40):
        moving = robot(seed, twin=TwinConfig())
        drifts = []
        for x in (0.6, 1.2):
            start = moving.world.pose
            moving._move(np.array([[x, 0.0]]), 0.0)
            drifts.append((start.inverse() @ moving.world.pose).yaw)
        bent.append(drifts)
    first, second = np.array(bent).T
    expected = 0.6 * math.hypot(0.006, 0.006) / 0.235  # of the wheels' radii by the wheel base
    assert np.std(first) == pytest.approx(expected, rel=0.3)
    assert np.corrcoef(first, second)[0, 1] > 0.95


def test_an_ideal_robot_only_slips():
    errors = []
    for seed in range(200):
        moving = robot(seed)
        start = moving.world.pose
        moving._move(np.array([[0.0, 0.8]]), 0.5)
        true = start.inverse() @ moving.world.pose
        errors.append([true.x, true.y - 0.8, true.yaw - 0.5])
    spread = np.std(np.array(errors), axis=0)
    assert spread == pytest.approx([SLIP_XY, SLIP_XY, SLIP_YAW], rel=0.2)
    assert np.mean(errors, axis=0) == pytest.approx([0, 0, -0.5 * TURN_CREEP / 0.7], abs=6e-3)


def test_it_errs_as_the_robot_of_the_physics_does():
    """The same robots, the same moves: what the wheels' errors explain is most of the error."""
    goal, errors = Pose2(0.0, 0.8, 0.9), {"physics": [], "kinematic": []}
    for seed in range(8):
        drawn = draw_robot(SCENE, seed, TwinConfig().errors)
        with open_sim(SCENE, seed) as (real, truth):
            start = truth.pose_at(0.0)
            drive_to(real, goal.x, goal.y, CONFIG.motion)
            turn_to(real, goal.yaw, CONFIG.motion)
            real.clock.sleep(0.5)
            end = real.base.odometry().T_odom_base
            true = start.inverse() @ truth.pose_at(real.clock.now())
        path = np.array([[end.x, end.y]])
        drifted = apply_motion_errors(Pose2(), path, end.yaw, CREATE2, drawn)
        for name, there in (("physics", true), ("kinematic", drifted)):
            off = (there.x - end.x, there.y - end.y, wrap(there.yaw - end.yaw))
            errors[name].append(off)
    physics, kinematic = np.array(errors["physics"]), np.array(errors["kinematic"])
    assert np.std(physics, axis=0)[2] > 0.01
    left = np.sqrt(np.mean((physics - kinematic) ** 2, axis=0))
    assert left[:2] == pytest.approx([0, 0], abs=2.0 * SLIP_XY)
    assert left[2] < 2.0 * SLIP_YAW
    for share in (0.5, 0.9):
        ours, theirs = (np.quantile(np.abs(e), share, axis=0) for e in (kinematic, physics))
        assert ours[2] == pytest.approx(theirs[2], rel=0.15, abs=SLIP_YAW)
        assert ours[:2] == pytest.approx(theirs[:2], rel=0.25, abs=SLIP_XY)


def test_the_same_seed_gives_the_same_bits():
    one, two, other = (
        robot(seed, twin=TwinConfig()).take_panorama().image.ranges for seed in (1, 1, 2)
    )
    assert np.array_equal(one, two, equal_nan=True)
    assert not np.array_equal(one, other, equal_nan=True)


def test_time_passes_as_with_a_real_robot():
    moving = robot()
    moving.take_panorama()
    turned = math.tau / CONFIG.sweep.look_rate
    assert turned < moving.world.time < turned + 10.0
    before = moving.world.time
    moving.observe(np.array([[0.0, 0.5]]), 0.0)
    assert 14.5 < moving.world.time - before < 22.0  # 2.5 s drive, 12 s sweep, turns


def test_the_world_remembers_where_it_was():
    world = KinematicWorld(Pose2(1.0, 2.0, 3.0))
    world.add(2.0, Pose2(1.0, 2.0, -3.0))
    early, middle, late = world.base_poses(np.array([-1.0, 1.0, 9.0]))
    assert early.tolist() == [1.0, 2.0, 3.0]
    assert middle[2] == pytest.approx(-math.pi)  # the short way
    assert late[2] == pytest.approx(-3.0)
    assert world.scene_qpos().size == 0


def test_thinning_leaves_every_third_beam_and_fewer_points_to_ask_for():
    spec = link_spec("usb")
    thin = thin_spec(spec, Thinning())
    assert thin.n_beams < spec.n_beams / 3
    assert np.diff(thin.elevations) == pytest.approx(3 * (spec.elevations[1] - spec.elevations[0]))
    assert set(thin.beam_times) <= set(spec.beam_times)
    assert thin_config(CONFIG, Thinning()).target.min_points == 10


def test_a_sweep_is_placed_by_its_middle_line():
    moving = robot()
    seen = moving.observe(np.array([[0.0, 0.4]]), 0.3)
    view = type("View", (), {"observation": seen})()
    placed = moving.truth.spawn.inverse() @ find_true_pose(view, moving.truth)
    assert placed.distance(seen.T_odom_scan) < 0.02
    assert placed.yaw == pytest.approx(0.3, abs=0.02)
