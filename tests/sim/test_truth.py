import math

import numpy as np
import pytest

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim


@pytest.fixture
def truth():
    """The ground truth of three boxes without errors."""
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (_, truth):
        yield truth


def test_surface_covers_the_boxes_but_not_their_bottoms(truth):
    points, normals = truth.surface(0.02)
    faces = sum(
        2 * h * (w + d) + w * d
        for w, d, h in ((0.80, 0.40, 0.60), (0.40, 0.30, 0.40), (0.90, 0.50, 0.70))
    )
    assert len(points) == pytest.approx(faces / 0.02**2, rel=0.03)
    assert normals[:, 2].min() >= 0.0
    assert points.min(axis=0) == pytest.approx([0.60, -1.15, 0.0], abs=0.015)
    assert points.max(axis=0) == pytest.approx([1.15, 1.15, 0.70], abs=1e-9)


def test_surface_points_are_what_rays_hit(truth):
    points, normals = truth.surface(0.05)
    distances = truth.first_hits(points + 0.05 * normals, -normals)
    assert distances == pytest.approx(0.05, abs=1e-9)


def test_the_sine_side_is_a_sine():
    with open_sim("sine_box", 0) as (_, truth):
        points, normals = truth.surface(0.01)
    side = points[normals[:, 0] < -0.3]
    expected = -0.15 + 0.02 * np.sin(math.tau * side[:, 1] / 0.08)
    assert len(side) > 1500
    assert side[:, 0] == pytest.approx(expected, abs=2e-4)


def test_the_sine_box_has_one_notch_at_the_back():
    with open_sim("sine_box", 0) as (_, truth):
        ys = np.linspace(-0.1991, 0.1987, 200)
        origins = np.stack([np.full(200, 1.0), ys, np.full(200, 0.253)], axis=1)
        depth = truth.first_hits(origins, np.tile([-1.0, 0.0, 0.0], (200, 1))) - 0.85
    inside = np.abs(ys) < 0.015
    assert depth[inside] == pytest.approx(0.03, abs=1e-6)
    assert depth[~inside] == pytest.approx(0.0, abs=1e-6)


def test_first_hits_leave_the_robot_out(truth):
    down = truth.first_hits(np.array([[-0.9, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert down == pytest.approx([1.0])


def test_first_hits_are_infinite_where_there_is_nothing(truth):
    assert truth.first_hits(np.array([[0.0, 0.0, 5.0]]), np.array([[0.0, 0.0, 1.0]])) == np.inf


def test_locate_is_in_the_odometry_frame(truth):
    assert truth.locate("target_left") == pytest.approx((0.80 + 0.90, 0.75), abs=1e-3)
    assert truth.locate("target_right") == pytest.approx((0.90 + 0.90, -0.70), abs=1e-3)


def test_locate_lists_the_targets(truth):
    with pytest.raises(UnknownNameError, match=r"'box'.*target_left, target_middle, target_right"):
        truth.locate("box")


def test_front_and_spawn(truth):
    assert (truth.spawn.x, truth.spawn.y) == (-0.9, 0.0)
    assert (truth.front.x, truth.front.y) == (0.6, 0.0)
    with open_sim("sine_box", 0) as (_, other):
        assert other.front is None


def test_pose_at_is_the_pose_of_that_time():
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, truth):
        robot.base.set_velocity(0.0, math.radians(30))
        robot.clock.sleep(3.0)
        early, late = truth.pose_at(1.0), truth.pose_at(2.0)
        assert late.yaw - early.yaw == pytest.approx(math.radians(30), rel=0.02)
        now = robot.clock.now()
        assert truth.pose_at(now).yaw > truth.pose_at(now - 0.01).yaw
        assert truth.pose_at(now + 1.0) == truth.pose_at(now)
