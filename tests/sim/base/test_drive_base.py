import math
from contextlib import suppress
from itertools import pairwise

import pytest

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.navigation.wheel_kinematics import split_velocity
from scan3d_twin.devices.create.model import CREATE2
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim

LEDGE = (
    '<geom name="floor" type="box" size="1 5 .5" pos="0 {y} -.5"/>'
    '<geom name="target" size=".1" pos="9 0 0"/>'
)


def test_constants_quoted_from_their_sources():
    assert (CREATE2.wheel_base, CREATE2.wheel_diameter) == (0.235, 0.072)
    assert CREATE2.counts_per_turn == 508.8
    assert CREATE2.max_wheel_speed == 0.5
    assert CREATE2.sample_period == 0.015


def test_one_count_is_0_4446_mm():
    assert math.pi * CREATE2.wheel_diameter / CREATE2.counts_per_turn == pytest.approx(
        0.44456e-3, rel=1e-4
    )


@pytest.mark.parametrize(
    ("linear", "angular", "left", "right"),
    [
        (0.1, 0.0, 0.1, 0.1),
        (0.0, 0.8, -0.094, 0.094),
        (0.0, math.radians(5), -0.010, 0.010),
        (1.0, 0.0, 0.5, 0.5),
        (0.0, -10.0, 0.5, -0.5),
        (1.0, 4.0, 0.18, 0.5),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_wheel_speeds_are_whole_millimetres_within_the_limit(linear, angular, left, right):
    assert split_velocity(CREATE2, linear, angular) == pytest.approx((left, right), abs=1e-12)


def test_odometry_moves_in_whole_counts():
    count = math.pi * 0.072 / 508.8
    with open_sim("three_boxes", 0) as (robot, _):
        robot.base.set_velocity(0.05, 0.0)
        robot.clock.sleep(1.0)
        samples = robot.base.odometry_since(0.0)
    way = sum(
        math.hypot(b.T_odom_base.x - a.T_odom_base.x, b.T_odom_base.y - a.T_odom_base.y)
        for a, b in pairwise(samples)
    )
    assert 2 * way / count == pytest.approx(round(2 * way / count), abs=1e-3)
    assert way > 0.04


def test_odometry_is_the_encoders_and_not_the_truth(bare):
    with open_sim(bare, 3) as (robot, truth):
        robot.base.set_velocity(0.2, 0.0)
        robot.clock.sleep(5.0)
        error = truth.spawn.inverse() @ truth.pose_at(robot.clock.now())
        assert abs(error.yaw - robot.base.odometry().T_odom_base.yaw) > math.radians(0.2)


def test_samples_come_every_15_ms(bare):
    with open_sim(bare, 0) as (robot, _):
        robot.clock.sleep(1.5)
        assert len(robot.base.odometry_since(0.0)) == 101


def test_speed_ramps_up_at_the_firmwares_pace(bare):
    with open_sim(bare, 0, TwinConfig.ideal()) as (robot, truth):
        robot.base.set_velocity(0.45, 0.0)
        robot.clock.sleep(0.25)

        def speed(time):
            """Return the true forward speed at ``time`` [m/s]."""
            return (truth.pose_at(time + 0.01).x - truth.pose_at(time - 0.01).x) / 0.02

        assert (speed(0.22) - speed(0.12)) / 0.10 == pytest.approx(1.8, rel=0.15)


@pytest.mark.parametrize(
    ("y", "linear", "angular", "name"),
    [
        (0.0, 0.2, 0.0, "cliff front"),
        (4.85, 0.0, -0.4, "cliff right"),
    ],
)
def test_a_cliff_stops_the_robot_before_it_falls(scene_of, y, linear, angular, name):
    with open_sim(scene_of(LEDGE.format(y=y)), 0) as (robot, truth):
        robot.base.set_velocity(linear, angular)
        with pytest.raises(HazardError, match=name):
            robot.clock.sleep(15.0)
        with suppress(HazardError):
            robot.clock.sleep(0.5)
        assert not any("drop" in hazard for hazard in robot.base.hazards().active())
        assert truth.pose_at(robot.clock.now()).x < 0.9


def test_lifting_the_robot_drops_its_wheels(bare):
    with open_sim(bare, 0) as (robot, _):
        robot.clock.sleep(0.1)
        data = robot.base._world.data
        data.qpos[2] += 0.3
        with pytest.raises(HazardError, match="cliff left"):
            robot.clock.sleep(0.05)
        with pytest.raises(HazardError, match="wheel drop left, wheel drop right"):
            robot.clock.sleep(0.2)


@pytest.mark.parametrize("seed", range(6))
def test_a_bumper_stays_pressed_until_the_robot_backs_off(seed):
    with open_sim("plain_wall", seed) as (robot, truth):
        robot.base.set_velocity(0.2, 0.0)
        with pytest.raises(HazardError):
            robot.clock.sleep(10.0)
        for _ in range(20):
            robot.clock.sleep(0.03)
            assert "bump left" in robot.base.hazards().active()
        touching = truth.pose_at(robot.clock.now())
        robot.base.set_velocity(-0.1, 0.0)
        robot.clock.sleep(1.0)
        assert touching.distance(truth.pose_at(robot.clock.now())) > 0.05
        assert robot.base.hazards().active() == ()


@pytest.mark.parametrize(
    ("y", "names"),
    [(0.0, {"bump left", "bump right"}), (0.2, {"bump left"}), (-0.2, {"bump right"})],
)
def test_the_bumper_knows_its_side(scene_of, y, names):
    post = f'<geom name="target" type="cylinder" size=".1 .2" pos=".6 {y} .2"/>'
    with open_sim(scene_of(post), 0) as (robot, _):
        robot.base.set_velocity(0.2, 0.0)
        with pytest.raises(HazardError):
            robot.clock.sleep(5.0)
        assert set(robot.base.hazards().active()) == names
