"""How the robot moves: tolerance bands, taken from the tuned model and typical Create figures."""

import math

import numpy as np
import pytest

from scan3d_twin.core.errors import HazardError
from scan3d_twin.sim.config import IDEAL_LIDAR, IDEAL_ROBOT, RobotErrorConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.world import TIMESTEP


def move(robot, truth, linear, angular, seconds):
    """Drive; return the true motion and the motion by odometry."""
    truly, reckoned = truth.pose_at(robot.clock.now()), robot.base.odometry().T_odom_base
    robot.base.set_velocity(linear, angular)
    robot.clock.sleep(seconds)
    robot.base.set_velocity(0.0, 0.0)
    robot.clock.sleep(0.5)
    return (
        truly.inverse() @ truth.pose_at(robot.clock.now()),
        reckoned.inverse() @ robot.base.odometry().T_odom_base,
    )


def test_a_90_degree_spin(bare):
    with open_sim(bare, 0, TwinConfig.ideal()) as (robot, truth):
        _, sent = robot.base.set_velocity(0.0, math.radians(30))
        truly, reckoned = move(robot, truth, 0.0, math.radians(30), math.radians(90) / sent)
    assert math.degrees(truly.yaw) == pytest.approx(89.5, abs=1.0)
    assert math.degrees(reckoned.yaw) == pytest.approx(90.0, abs=0.5)
    assert math.degrees(abs(truly.yaw - reckoned.yaw)) < 0.5
    assert math.hypot(truly.x, truly.y) < 0.001


def test_a_metre_ahead(bare):
    with open_sim(bare, 0, TwinConfig.ideal()) as (robot, truth):
        truly, reckoned = move(robot, truth, 0.2, 0.0, 5.0)
    assert truly.x == pytest.approx(1.0, abs=0.008)
    assert truly.x == pytest.approx(reckoned.x, abs=0.003)
    assert math.degrees(abs(truly.yaw)) < 0.2


def test_a_slow_sweep_keeps_its_pace(bare):
    with open_sim(bare, 0, TwinConfig.ideal()) as (robot, truth):
        _, sent = robot.base.set_velocity(0.0, math.radians(5))
        truly, _ = move(robot, truth, 0.0, math.radians(5), 6.0)
    assert truly.yaw == pytest.approx(6.0 * sent, rel=0.01)


def test_odometry_errs_as_a_typical_create_does(bare):
    turns, ways, headings = [], [], []
    for seed in range(24):
        with open_sim(bare, seed) as (robot, truth):
            truly, reckoned = move(robot, truth, 0.0, math.radians(30), 3.0)
            turns.append(math.degrees(truly.yaw - reckoned.yaw))
            truly, reckoned = move(robot, truth, 0.2, 0.0, 5.0)
            ways.append(math.hypot(truly.x, truly.y) / math.hypot(reckoned.x, reckoned.y) - 1)
            headings.append(math.degrees(truly.yaw - reckoned.yaw))
    # 24 draws estimate a standard deviation within about 30 % (95 %); theory: .98, .42 %, 2.07.
    assert 0.6 < np.std(turns) < 1.4
    assert 0.0028 < np.std(ways) < 0.0060
    assert 1.4 < np.std(headings) < 2.8
    assert abs(np.mean(headings)) < 1.3


def shake(scene, cogging, rate):
    """Return the rms residual of the scan plane's yaw and pitch during a spin [deg]."""
    errors = RobotErrorConfig(0.0, 0.0, 0.7, 0.7, cogging)
    with open_sim(scene, 3, TwinConfig(lidar=IDEAL_LIDAR, errors=errors)) as (robot, _):
        robot.base.set_velocity(0.0, math.radians(rate))
        robot.clock.sleep(8.0)
        world = robot.base._world
        times = np.arange(world.steps - 3000, world.steps - 2) * TIMESTEP
        _, rotations = world.lidar_poses(times)
    yaw = np.unwrap(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
    residual = yaw - np.polyval(np.polyfit(times, yaw, 1), times)
    pitch = np.arcsin(rotations[:, 2, 0])
    return math.degrees(residual.std()), math.degrees(pitch.std())


def test_cogging_shakes_the_scan_plane(bare):
    smooth, _ = shake(bare, 0.0, 5)
    yaw, pitch = shake(bare, 0.03, 5)
    assert smooth < 0.002
    assert 0.003 < yaw < 0.03
    assert 0.001 < pitch < 0.03


def test_more_cogging_shakes_more(bare):
    assert shake(bare, 0.04, 5)[0] > 1.5 * shake(bare, 0.02, 5)[0]


def test_the_ripple_meets_the_pitch_mode_at_higher_speed(bare):
    assert shake(bare, 0.03, 20)[1] > 2 * shake(bare, 0.03, 5)[1]


def test_random_commands_never_upset_the_physics(scene_of):
    posts = "".join(
        f'<geom type="box" size=".05 .05 .3" pos="{0.45 * c:.3f} {0.45 * s:.3f} .3"/>'
        for c, s in (
            (math.cos(math.radians(angle)), math.sin(math.radians(angle)))
            for angle in range(0, 360, 45)
        )
    )
    scene = scene_of(posts + '<geom name="target" size=".1" pos="3 0 .1"/>')
    rng = np.random.default_rng(5)
    tilts, hazards = [], 0
    for seed in range(32):
        with open_sim(scene, seed) as (robot, _):
            world = robot.base._world
            for _ in range(60):
                left, right = rng.uniform(-0.5, 0.5, 2)
                robot.base.set_velocity((left + right) / 2, (right - left) / 0.235)
                try:
                    robot.clock.sleep(0.25)
                except HazardError:
                    hazards += 1
                assert np.isfinite(world.data.qpos).all()
                assert np.isfinite(world.data.qvel).all()
                tilts.append(world.data.body("robot/base").xmat[8])
            assert not any(warning.number for warning in world.data.warning)
    assert hazards > 0
    assert math.degrees(math.acos(min(tilts))) < 2.0


def test_an_ideal_robot_still_slips_a_little(bare):
    with open_sim(bare, 0, TwinConfig(errors=IDEAL_ROBOT)) as (robot, truth):
        truly, reckoned = move(robot, truth, 0.3, 1.0, 3.0)
    assert 1e-5 < truly.distance(reckoned) < 0.02
