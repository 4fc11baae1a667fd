from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from synthetic import THREE_BOXES, observe

from scan3d_twin.core.navigation.costmap import build_costmap
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import Observation, Pose2, Scan3D

CONFIG = paper_config()
START, LATER = Pose2(-0.9, 0.0, 0.0), Pose2(-0.9, 1.0, -0.3)
DRIFT = Pose2(0.25, -0.1, 0.12)
"""Pose in the odometry of the later view of the frame in which the first view was taken."""


def at(view: Observation, T_world_scan: Pose2) -> View:
    """Return a view that registration puts at ``T_world_scan``."""
    nothing = Scan3D(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int), view.image.n_lines)
    return View(view, view.image, nothing, nothing, T_world_scan, None)


@pytest.fixture(scope="module")
def session() -> Session:
    """Return a session of a panorama and two views between which the odometry drifted."""
    panorama = observe(START, THREE_BOXES, width=math.tau - 1e-3, step=math.radians(2.0))
    first = replace(observe(START, THREE_BOXES), touched=((0.5, 0.25),))
    second = observe(LATER, THREE_BOXES)
    drifted = replace(second, T_odom_scan=DRIFT @ second.T_odom_scan)
    views = (at(first, first.T_odom_scan), at(drifted, second.T_odom_scan))
    return Session(CONFIG, 0, np.zeros((0, 2)), np.array([1.0, 0.0]), ((0, panorama),), views)


def test_what_was_seen_before_lies_where_it_is_by_registration(session: Session) -> None:
    panorama, first, second = session.observations()
    for old in (panorama, first):
        assert old.T_odom_scan.distance(DRIFT @ START) < 1e-12
        assert old.T_odom_scan.yaw == pytest.approx(DRIFT.yaw + START.yaw)
    assert np.allclose(first.touched, DRIFT.apply(np.array([[0.5, 0.25]])))
    assert second is session.views[1].observation


def test_the_observations_of_one_view_stay_as_they_are(session: Session) -> None:
    early = replace(session, views=session.views[:1])
    assert early.observations() == (session.panoramas[0][1], session.views[0].observation)


def test_drift_opens_no_way_through_a_wall(session: Session) -> None:
    here = session.views[1].observation.T_odom_scan
    behind_wall = DRIFT @ Pose2(-0.9, 1.95, 0.0)
    by_odometry = (session.panoramas[0][1], *(view.observation for view in session.views))
    assert build_costmap(by_odometry, CONFIG, here).is_feasible(behind_wall.x, behind_wall.y)
    placed = build_costmap(session.observations(), CONFIG, here)
    assert not placed.is_feasible(behind_wall.x, behind_wall.y)
    beside = DRIFT @ Pose2(-0.9, 1.6, 0.0)
    assert placed.is_feasible(beside.x, beside.y)


@pytest.mark.parametrize("optimize_for", ["speed", "memory"])
def test_the_known_target_follows_its_views(session: Session, optimize_for: str) -> None:
    view, hint = session.views[0], np.array([[0.5, 0.0]])
    config = replace(CONFIG, optimize_for=optimize_for)
    points = np.array([[1.0, 0.2, 0.3], [1.1, -0.2, 0.4]])
    shown = replace(view, target=Scan3D(points, np.arange(2), np.arange(2), 2))
    one = replace(session, config=config, hint=hint, views=(shown,))
    for _ in range(2):
        expected = np.concatenate([hint, START.apply(points[:, :2])])
        np.testing.assert_array_equal(one.gather_known_target(), expected)

    # Where a view has moved, or shows something else, what was kept is not used
    moved = replace(one, views=(replace(shown, T_world_scan=LATER),))
    expected = np.concatenate([hint, LATER.apply(points[:, :2])])
    np.testing.assert_array_equal(moved.gather_known_target(), expected)
    other = replace(moved, views=(replace(moved.views[0], target=shown.target.first_lines(1)),))
    np.testing.assert_array_equal(other.gather_known_target(), expected[:2])
