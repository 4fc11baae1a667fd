"""Walls: found by their height and length, and separated from what stands at them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from paper import paper_config
from synthetic import ROOM, Box, observe

from scan3d_twin.core.scanning.target.extraction import extract_points, extract_target
from scan3d_twin.core.scanning.target.selection import find_target, find_targets
from scan3d_twin.core.scanning.target.walls import find_walls
from scan3d_twin.core.types import FloatArray, Observation, Pose2

CONFIG = paper_config()
HERE = Pose2()
AT_WALL = Box((2.1, -0.35, 0.0), (2.5, 0.35, 0.7))
"""Its back is at the wall x = 2.5 of the room."""


def look(*boxes: Box, room: bool = True, spawn: Pose2 = HERE) -> Observation:
    """Return a panorama of ``boxes`` with the noise of the lidar."""
    return observe(
        spawn,
        boxes,
        width=math.tau - 1e-3,
        step=math.radians(2.0),
        room=room,
        sigma=0.008,
        rng=np.random.default_rng(0),
    )


def points_of(seen: Observation) -> FloatArray:
    """Return the points of an observation in its frame ``scan``."""
    return extract_points(seen.image, CONFIG).points


def test_the_walls_of_a_room_are_found_where_they_are() -> None:
    walls = find_walls(points_of(look(AT_WALL, spawn=Pose2(0.0, 0.3, 0.0))), 4.0)
    (x0, x1), (y0, y1), _ = ROOM
    expected = {(-1, 0): x1, (1, 0): -x0, (0, -1): y1 - 0.3, (0, 1): 0.3 - y0}
    assert len(walls) == 4
    for normal, distance in expected.items():
        (wall,) = (each for each in walls if each.normal @ normal > 0.99)
        assert wall.offset == pytest.approx(-distance, abs=0.02)


def test_low_and_short_things_are_no_walls() -> None:
    low = Box((1.5, -1.8, 0.0), (1.9, 1.8, 1.5))
    narrow = Box((1.5, -0.4, 0.0), (1.9, 0.4, 2.4))
    for box in (low, narrow):
        assert find_walls(points_of(look(box, room=False)), 4.0) == []


def test_a_thing_under_a_ceiling_is_no_wall() -> None:
    """The lidar sees both above one another."""
    table = Box((0.8, -0.9, 0.0), (1.4, 0.9, 0.7))
    walls = find_walls(points_of(look(table)), 4.0)
    assert len(walls) == 4
    assert all(not wall.contains(np.array([[0.8, 0.0]])).any() for wall in walls)


def test_what_stands_at_a_wall_is_found_without_the_wall() -> None:
    hint = find_target(look(AT_WALL), None, CONFIG)
    assert hint[:, 0].min() == pytest.approx(2.1, abs=0.04)
    assert hint[:, 0].max() < 2.5
    assert np.abs(hint[:, 1]).max() < 0.45


def test_a_thing_in_the_open_comes_before_a_larger_one_at_the_wall() -> None:
    small = Box((1.0, 0.6, 0.0), (1.2, 0.9, 0.4))
    first, second = find_targets(look(AT_WALL, small), 2, CONFIG)
    assert first[:, 1].min() > 0.5
    assert np.abs(second[:, 1]).max() < 0.45


def test_a_wall_that_the_range_cuts_off_does_not_stand_free() -> None:
    """It ends in view, but only because the lidar sees no farther."""
    wall = Box((-8.0, 2.0, 0.0), (8.0, 2.1, 2.5))
    thing = Box((1.6, -0.2, 0.0), (1.8, 0.2, 0.3))
    hint = find_target(look(wall, thing, room=False), None, CONFIG)
    assert hint[:, 1].max() < 0.3
    low = Box((-8.0, 2.0, 0.0), (8.0, 2.1, 0.9))  # no wall by its height, but cut off as well
    assert find_target(look(low, thing, room=False), None, CONFIG)[:, 1].max() < 0.3


def test_a_small_low_thing_is_seen_from_where_a_mesh_is_placed() -> None:
    small = Box((1.5, -0.05, 0.0), (1.6, 0.05, 0.1))
    for room in (True, False):
        hint = find_target(look(small, room=room), None, CONFIG)
        assert hint[:, 0].max() < 1.65
        assert np.abs(hint[:, 1]).max() < 0.1


@pytest.mark.parametrize("place", [Pose2(1.1, 0.0, 0.0), Pose2(1.7, -1.3, math.radians(60.0))])
def test_a_sweep_takes_the_thing_and_not_its_wall(place: Pose2) -> None:
    seen = observe(place, (AT_WALL,), sigma=0.008, rng=np.random.default_rng(1))
    known = seen.T_odom_scan.inverse().apply(find_target(look(AT_WALL), None, CONFIG))
    sweep = extract_points(seen.image, CONFIG)
    target = extract_target(seen.image, sweep, known, CONFIG.target)
    points = seen.T_odom_scan.apply(target.points)
    assert len(target) > 2000
    assert points[:, 0].max() < 2.5
    assert np.abs(points[:, 1]).max() < 0.45
    assert points[:, 2].max() < 0.75


def test_a_wall_that_is_the_target_stays() -> None:
    seen = observe(Pose2(1.3, 0.0, 0.0), (), sigma=0.008, rng=np.random.default_rng(1))
    known = np.column_stack([np.full(40, 1.2), np.linspace(-1.0, 1.0, 40)])
    sweep = extract_points(seen.image, CONFIG)
    target = extract_target(seen.image, sweep, known, CONFIG.target)
    assert len(find_walls(sweep.points, 4.0)) > 0
    assert np.ptp(target.points[:, 1]) > 1.2


def test_a_wall_that_is_the_target_stays_where_odometry_errs() -> None:
    """After the first move, odometry puts the wall beside itself; only its end may be off it."""
    wall = Box((1.3, -3.0, 0.0), (1.4, 1.0, 2.5))
    there = Pose2(-0.1, 2.3, -math.radians(45.0))
    seen = observe(there, (wall,), room=False, sigma=0.008, rng=np.random.default_rng(1))
    erring = there @ Pose2(0.02, -0.05, math.radians(4.0))
    front = np.column_stack([np.full(80, 1.3), np.linspace(-3.0, 1.0, 80)])
    known = erring.inverse().apply(front)
    sweep = extract_points(seen.image, CONFIG)
    (plane,) = find_walls(sweep.points, 4.0)
    assert not plane.contains(known, 0.06).any()
    target = extract_target(seen.image, sweep, known, CONFIG.target)
    assert np.mean(plane.contains(target.points[:, :2])) > 0.8


def test_the_next_side_of_a_high_cupboard_stays() -> None:
    """Of the side, only its edge is known yet; what is known lies behind its plane."""
    cupboard = Box((0.0, -0.9, 0.0), (1.5, 0.9, 2.1))
    seen = observe(Pose2(0.75, -2.0, math.radians(90.0)), (cupboard,), room=False)
    front = np.column_stack([np.zeros(60), np.linspace(-0.9, 0.9, 60)])
    sweep = extract_points(seen.image, CONFIG)
    assert len(find_walls(sweep.points, 4.0)) == 1
    known = seen.T_odom_scan.inverse().apply(front)
    target = extract_target(seen.image, sweep, known, CONFIG.target)
    points = seen.T_odom_scan.apply(target.points)
    assert np.ptp(points[:, 0]) > 1.1
