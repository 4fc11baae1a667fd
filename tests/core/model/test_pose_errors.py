from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from box_truth import FIRST, BoxTruth, session_of

from scan3d_twin.core.model.pose_errors import (
    find_even_lines,
    find_true_pose,
    measure_displacement,
)
from scan3d_twin.core.types import Pose2, read_only

pytestmark = pytest.mark.slow


def test_the_true_pose_is_that_of_all_lines() -> None:
    """The error of a single line, even of the middle one, is not that of the sweep."""
    view = session_of(FIRST).views[0]
    pose = find_true_pose(view, BoxTruth((FIRST,)))
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((FIRST.x, FIRST.y, FIRST.yaw), abs=1e-6)

    # One line that was read 10 mrad off, and all of them
    yaws = view.observation.image.yaws
    middle = int(np.argmin(np.abs(yaws[:, yaws.shape[1] // 2])))
    for lines, least, most in ((middle, -0.0004, 0.0), (np.s_[:], -0.0101, -0.0099)):
        shaken = yaws.copy()
        shaken[lines] += 0.010
        image = replace(view.observation.image, yaws=read_only(shaken))
        moved = replace(view, observation=replace(view.observation, image=image))
        assert least <= find_true_pose(moved, BoxTruth((FIRST,))).yaw - pose.yaw <= most


def test_the_true_pose_of_a_sweep_that_goes_on_to_one_side_is_the_one_at_heading_zero() -> None:
    """Turns that are 2 % too small shift the mean heading of what lies to one side only."""
    view = session_of(FIRST).views[0]
    pose = find_true_pose(view, BoxTruth((FIRST,)))
    image = view.observation.image
    kept = image.yaws[:, image.spec.n_beams // 2] > -math.radians(15.0)
    image = replace(
        image, stamps=image.stamps[kept], yaws=read_only(0.98 * image.yaws[kept]),
        ranges=image.ranges[kept], codes=image.codes[kept],
    )  # fmt: skip
    uneven = replace(view, observation=replace(view.observation, image=image))
    turned = find_true_pose(uneven, BoxTruth((FIRST,))).yaw - pose.yaw
    assert abs(turned) < 0.02 * math.radians(0.5)


@pytest.mark.parametrize(
    ("first", "last", "even"),
    [(10, -10, 21), (10, -9, 20), (10, -4, 10), (4, -10, 10), (10, 3, 8), (-3, -10, 8), (0, 0, 1)],
)
def test_even_lines_lie_to_both_sides_or_are_all(first: int, last: int, even: int) -> None:
    headings = np.arange(first, last - 1, -1) * math.radians(0.5)
    kept = find_even_lines(headings)
    assert kept.sum() == even
    assert abs(headings[kept].mean()) < math.radians(0.5) or kept.all()


def test_displacement_of_a_turn_grows_with_the_distance() -> None:
    near, far = np.array([[1.0, 0.0, 0.0]]), np.array([[2.0, 0.0, 0.0]])
    turn = Pose2(0.0, 0.0, 0.01)
    assert measure_displacement(near, Pose2(), turn) == pytest.approx(0.01, rel=1e-4)
    assert measure_displacement(far, Pose2(), turn) == pytest.approx(0.02, rel=1e-4)
