from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from paper import paper_config
from synthetic import THREE_BOXES, Box, observe

from scan3d_twin.core.navigation.costmap import (
    RESOLUTION,
    Costmap,
    build_costmap,
)
from scan3d_twin.core.types import FloatArray, Observation, Pose2

CONFIG = paper_config()
SPAWN = Pose2(-0.9, 0.0, 0.0)
CLEAR = CONFIG.motion.robot_radius + CONFIG.motion.clearance


def look(boxes: tuple[Box, ...], spawn: Pose2 = SPAWN) -> Observation:
    """Return a panorama of ``boxes``."""
    return observe(spawn, boxes, width=math.tau - 1e-3, step=math.radians(2.0))


@pytest.fixture(scope="module")
def costmap() -> Costmap:
    """Return the costmap after a panorama of three boxes."""
    return build_costmap((look(THREE_BOXES),), CONFIG, SPAWN)


def least_distance(path: FloatArray, box: Box) -> float:
    """Return the distance between ``path`` and ``box`` in the top view [m]."""
    points = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(path)])
    outside = np.maximum(0, np.maximum(box.low[:2] - points, points - box.high[:2]))
    return float(np.hypot(outside[:, 0], outside[:, 1]).min())


def test_the_robot_keeps_its_radius_from_walls_and_boxes(costmap: Costmap) -> None:
    assert costmap.is_feasible(-0.9, 1.7)
    assert not costmap.is_feasible(-0.9, 2.0 - CLEAR + 2 * RESOLUTION)
    assert costmap.is_feasible(0.6 - CLEAR - 2 * RESOLUTION, 0.7)
    assert not costmap.is_feasible(0.6 - CLEAR + 2 * RESOLUTION, 0.7)


def test_unseen_floor_is_lethal(costmap: Costmap) -> None:
    assert not costmap.is_feasible(1.8, 0.8)  # behind the boxes
    assert not costmap.is_feasible(10.0, 0.0)  # off the map


def test_the_way_leads_around_an_obstacle() -> None:
    pillar = Box((-0.1, -0.3, 0.0), (0.1, 0.3, 0.5))
    beside = observe(Pose2(-0.9, 1.0, 0.0), (pillar,), width=math.tau - 1e-3, step=math.radians(2))
    costmap = build_costmap((look((pillar,)), beside), CONFIG, SPAWN)
    path = costmap.find_path(1.2, 0.6)
    assert path is not None
    way = np.concatenate([[[SPAWN.x, SPAWN.y]], path])
    assert tuple(path[-1]) == (1.2, 0.6)
    assert least_distance(way, pillar) > CONFIG.motion.robot_radius
    length = np.sum(np.hypot(*np.diff(way, axis=0).T))
    assert length < 1.4 * math.hypot(1.2 - SPAWN.x, 0.6)


def test_a_free_way_is_straight(costmap: Costmap) -> None:
    path = costmap.find_path(-1.8, 1.0)
    assert path is not None
    assert path == pytest.approx(np.array([[-1.8, 1.0]]))


def test_no_way_no_path(costmap: Costmap) -> None:
    assert costmap.find_path(2.2, 0.0) is None


def test_a_low_bridge_is_an_obstacle_and_a_high_one_is_not() -> None:
    for height, free in ((0.30, False), (0.60, True)):
        bridge = Box((-0.2, -2.0, height), (0.0, 2.0, height + 0.1))
        costmap = build_costmap((look((bridge,)),), CONFIG, SPAWN)
        assert costmap.is_feasible(0.9, 0.0) is free


def test_newer_observations_win() -> None:
    box = Box((-0.1, -0.2, 0.0), (0.3, 0.2, 0.5))
    before, after = look((box,)), look(())
    assert not build_costmap((after, before), CONFIG, SPAWN).is_feasible(0.1, 0.0)
    assert build_costmap((before, after), CONFIG, SPAWN).is_feasible(0.1, 0.0)


def test_a_missing_floor_is_not_free() -> None:
    observation = look(())
    points = observation.T_odom_scan.apply(observation.image.points)
    hole = (points[..., 0] > 0.5) & (points[..., 2] < 0.02)
    ranges = np.where(hole, np.nan, observation.image.ranges)
    object.__setattr__(observation.image, "ranges", ranges)
    costmap = build_costmap((observation,), CONFIG, SPAWN)
    assert costmap.is_feasible(0.0, 0.0)
    assert not costmap.is_feasible(0.9, 0.0)


def test_the_robot_can_leave_where_it_stands() -> None:
    tight = Pose2(0.6 - 0.18, 0.7, 0.0)  # closer than the clearance to a box
    costmap = build_costmap((look(THREE_BOXES),), CONFIG, tight)
    assert costmap.find_path(-0.9, 0.0) is not None
