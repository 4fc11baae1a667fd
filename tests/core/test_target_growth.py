"""What one view joins to the target, earlier views show as well."""

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from synthetic import Box

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.planning.candidates.hidden_surface import _recall_profiles
from scan3d_twin.core.session import Session
from scan3d_twin.core.target_growth import extend_targets
from scan3d_twin.core.types import Pose2

U = (
    Box((0.6, 0.5, 0.0), (1.5, 0.8, 0.6)),
    Box((0.6, -0.5, 0.0), (1.5, -0.2, 0.6)),
    Box((1.3, -0.2, 0.0), (1.5, 0.5, 0.6)),
)
"""A left and a right arm, open towards the robot, and what is between them at the back."""
HINT = np.array([[0.6, y] for y in np.linspace(0.5, 0.8, 7)])
FACING_LEFT, FACING_RIGHT = Pose2(-0.4, 0.65, -0.25), Pose2(-0.4, -0.35, 0.25)
"""Viewpoints that see the end of one arm, and the inner side of the other."""


def observe(pose, boxes=U):
    """Return what a sweep of 80 deg around ``pose`` sees."""
    return synthetic.observe(pose, boxes, width=math.radians(80.0))


def shows(view, x, y):
    """Return whether the target of ``view`` has points within 5 cm of a place in ``world``."""
    top = view.T_world_scan.apply(view.target.points)[:, :2]
    return bool(np.any(np.hypot(*(top - (x, y)).T) < 0.05))


@pytest.fixture(scope="module")
def first():
    """The session of the first view, before the left arm of which the robot stands."""
    session = Session(Config(), 0, HINT, np.array([-1.0, 0.0]))
    return integrate(session, observe(FACING_LEFT))


@pytest.fixture(scope="module")
def both(first):
    """The session with the second view."""
    return integrate(first, observe(FACING_RIGHT))


def test_an_arm_beyond_a_gap_belongs_to_the_target_once_the_part_between_is_seen(first, both):
    # The right arm was in sight from the start, but it touched nothing that was known
    right_arm, left_arm, between = (0.9, -0.2), (0.9, 0.5), (1.3, 0.3)
    assert not shows(first.views[0], *right_arm)

    # The second view joins the part between, the first one the right arm, and so the second one
    assert shows(both.views[1], *left_arm)
    assert shows(both.views[1], *between)
    assert shows(both.views[0], *right_arm)
    assert shows(both.views[1], 0.6, -0.35)


def test_what_stands_apart_stays_apart():
    apart = (U[0], U[1])  # without the part between: two things
    session = Session(Config(), 0, HINT, np.array([-1.0, 0.0]))
    for pose in (FACING_LEFT, FACING_RIGHT):
        session = integrate(session, observe(pose, apart))
    for view in session.views:
        assert view.target.points.size
        assert view.T_world_scan.apply(view.target.points)[:, 1].min() > 0.3


def test_nothing_changes_where_nothing_is_joined(both):
    again = extend_targets(both)
    assert all(a is b for a, b in zip(again.views, both.views, strict=True))


def test_a_target_that_grows_keeps_its_other_readings(first, both):
    before, after = first.views[0].target, both.views[0].target
    n_beams = first.views[0].image.spec.n_beams
    known, wider = (scan.lines * n_beams + scan.beams for scan in (before, after))
    assert set(known) < set(wider)


def test_profiles_follow_a_target_that_grows(first, both):
    narrow, workspace = first.views[0], first.workspace
    view = replace(both.views[0], image=narrow.image)  # the image that they are kept by
    before = _recall_profiles(narrow, workspace)
    after = _recall_profiles(view, workspace)
    assert sum(p.on_target.sum() for p in after) > sum(p.on_target.sum() for p in before)
