from __future__ import annotations

import math

import numpy as np
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.scanning.target.extraction import extract_points, extract_target, is_in_window
from scan3d_twin.core.types import Pose2

CONFIG = paper_config()
SPAWN = Pose2(-0.9, 0.0, 0.0)


def test_floor_robot_and_far_things_are_left_out() -> None:
    image = observe(SPAWN).image
    scan = extract_points(image, CONFIG)
    ranges = image.ranges[scan.lines, scan.beams]
    assert scan.points[:, 2].min() > CONFIG.target.floor_height / 2
    assert scan.points[ranges > 2.0, 2].min() > CONFIG.target.floor_height
    assert ranges.max() <= CONFIG.target.max_range
    assert np.hypot(scan.points[:, 0], scan.points[:, 1]).min() > CONFIG.motion.self_radius
    assert np.isfinite(image.points[..., 2]).sum() > len(scan)


def test_the_window_is_213_beams_around_384() -> None:
    image = observe(SPAWN).image
    beams = np.arange(image.spec.n_beams)
    inside = np.flatnonzero(is_in_window(image, np.zeros_like(beams), beams, CONFIG.target))
    middle = image.spec.n_beams // 2
    assert len(inside) == 213
    assert (inside[0], inside[-1]) == (middle - 106, middle + 106)


def test_the_target_is_extracted_without_the_room() -> None:
    observation = observe(Pose2(-0.4, 0.0, 0.0))
    sweep = extract_points(observation.image, CONFIG)
    known = np.array([[1.0, 0.5]])  # one point of the front is enough to identify the group
    target = extract_target(observation.image, sweep, known, CONFIG.target)
    x, y = observation.T_odom_scan.apply(target.points)[:, :2].T
    assert len(target) > 5000
    assert x.min() > 0.59
    assert x.max() < 1.16
    assert np.abs(y).max() < 1.16
    assert len(target) < len(sweep)


def test_stray_points_are_left_out() -> None:
    observation = observe(Pose2(-0.4, 0.0, 0.0))
    ranges = observation.image.ranges.copy()
    ranges[60, 341] = 0.7  # in the air, in front of the boxes
    object.__setattr__(observation.image, "ranges", ranges)
    sweep = extract_points(observation.image, CONFIG)
    known = np.array([[1.0, 0.5], [0.7, 0.0]])
    target = extract_target(observation.image, sweep, known, CONFIG.target)
    assert np.hypot(target.points[:, 0], target.points[:, 1]).min() > 0.9


def test_a_target_out_of_sight_is_empty() -> None:
    observation = observe(Pose2(-0.4, 0.0, math.pi))
    sweep = extract_points(observation.image, CONFIG)
    known = np.array([[-1.2, 0.0]])
    assert len(extract_target(observation.image, sweep, known, CONFIG.target)) == 0


def test_a_group_is_the_target_when_it_comes_within_the_gap_of_what_is_known() -> None:
    box = Box((0.3, -0.4, 0.0), (0.7, 0.4, 0.6))
    image = observe(SPAWN, (box,), room=False).image
    sweep = extract_points(image, CONFIG)
    top, rng, gap = sweep.points[:, :2], np.random.default_rng(0), CONFIG.target.cluster_gap
    outcomes = []
    for _ in range(60):
        bearing = rng.uniform(-np.pi, np.pi)
        away = rng.uniform(0.0, 2 * gap) * np.array([np.cos(bearing), np.sin(bearing)])
        known = top[[rng.integers(len(top))]] + away
        near = np.linalg.norm(top - known, axis=1).min() <= gap
        target = extract_target(image, sweep, known, CONFIG.target)
        assert (len(target) > 0) == near
        outcomes.append(near)
    assert 10 < sum(outcomes) < 50


def test_near_the_robot_the_floor_takes_little_of_a_thing_and_none_of_it_stays() -> None:
    """At 1 m the floor is seen at a flat angle: its noise of 1 cm is 3 mm of height there."""
    low = Box((0.9, -0.3, 0.0), (1.2, 0.3, 0.1))
    rng = np.random.default_rng(3)
    image = observe(Pose2(), (low,), room=False, sigma=0.010, rng=rng).image
    scan = extract_points(image, CONFIG)
    front = np.abs(scan.points[:, 0] - 0.9) < 0.05
    assert scan.points[front, 2].min() < 0.022
    bare = observe(Pose2(), (), room=False, sigma=0.010, rng=rng).image
    readings = np.count_nonzero(np.isfinite(bare.ranges))
    assert len(extract_points(bare, CONFIG)) < 0.001 * readings  # of normal noise beyond 3 sigma
