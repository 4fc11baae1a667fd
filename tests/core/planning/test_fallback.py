"""What is done where no overlap meets epsilon, and what is said about it before driving."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sessions import BOX, WALL, session_at
from synthetic import Box

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import digitize
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import (
    describe_shortfall,
    expect_accuracy,
    plan_smallest_overlap,
)
from scan3d_twin.core.planning.planners.fisher import FisherPlanner
from scan3d_twin.core.planning.prediction.error_prediction import predict_by_odometry
from scan3d_twin.core.types import Plan, Pose2
from scan3d_twin.core.viewpoints import MAX_FRONT_ANGLE, measure_angle
from scan3d_twin.sim.robot import open_sim


@pytest.fixture(scope="module")
def wall() -> PlanningContext:
    """Return the context in front of a bare wall, with the preset ``best``."""
    return PlanningContext(session_at(WALL, Config()))


def is_straight(viewpoint: Pose2) -> bool:
    """Return whether a viewpoint faces the wall at right angles from the standoff of 1 m."""
    return abs(viewpoint.yaw) < 0.1 and abs(viewpoint.x) < 0.1


def test_the_least_error_is_taken_not_the_default(wall: PlanningContext) -> None:
    errors = {0.2: 0.119, 0.6: 0.040, 0.8: 0.060}
    plan = plan_smallest_overlap(wall, lambda eta, viewpoint: errors.get(eta, 0.100))
    assert plan.overlap == 0.6
    assert plan.predicted_rmse == 0.040
    assert plan.fell_back
    assert {c.overlap for c in plan.candidates} == {0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8}


def test_few_views_left_make_longer_steps(wall: PlanningContext) -> None:
    config = replace(wall.session.config, max_views=2)
    late = PlanningContext(replace(wall.session, config=config))
    errors = {0.2: 0.061, 0.3: 0.059, 0.8: 0.040}
    for context, overlap in ((wall, 0.8), (late, 0.3)):
        plan = plan_smallest_overlap(context, lambda eta, viewpoint: errors.get(eta, 0.1))
        assert plan.overlap == overlap
        assert plan.fell_back


def test_oblique_viewpoints_lead_onwards(wall: PlanningContext) -> None:
    ahead = wall.find_placement(0.8).viewpoint
    assert ahead is not None
    found = wall.find_oblique_viewpoints(0.8)
    assert found
    assert all(viewpoint.y < ahead.y for viewpoint in found)


def test_the_paper_takes_the_default_whatever_its_error() -> None:
    context = PlanningContext(session_at(WALL))
    plan = plan_smallest_overlap(context, lambda eta, viewpoint: 0.04 if eta == 0.6 else 0.06)
    assert plan.overlap == 0.8
    assert plan.predicted_rmse == 0.06


def test_an_oblique_viewpoint_that_meets_epsilon_is_no_fallback(wall: PlanningContext) -> None:
    def error(eta: float, viewpoint: Pose2) -> float:
        return 0.04 if is_straight(viewpoint) else 0.008

    plan = plan_smallest_overlap(wall, error)
    assert not plan.fell_back
    assert plan.overlap == 0.2
    assert plan.viewpoint is not None
    back = np.array([-math.cos(plan.viewpoint.yaw), -math.sin(plan.viewpoint.yaw)])
    assert abs(measure_angle(wall.session.front, back)) <= MAX_FRONT_ANGLE + 1e-6


def test_without_any_prediction_the_default_is_taken(wall: PlanningContext) -> None:
    plan = plan_smallest_overlap(wall, lambda eta, viewpoint: math.inf)
    assert plan.overlap == wall.session.config.planning.default_overlap
    assert plan.fell_back


def test_nothing_meets_a_micrometre_and_the_plan_says_what_is_expected(
    wall: PlanningContext,
) -> None:
    session = wall.session
    planning = replace(session.config.planning, epsilon=1e-6)
    session = replace(session, config=replace(session.config, planning=planning))
    plan = FisherPlanner().plan(session, np.random.default_rng(0))
    assert plan.fell_back
    assert plan.predicted_rmse <= 1.05 * min(c.predicted_rmse for c in plan.candidates)
    expected = f"0.001 mm is below the expected {1e3 * plan.predicted_rmse:.1f} mm"
    assert describe_shortfall(plan, 1e-6) == expected
    assert expect_accuracy(session.with_plan(plan)) == plan.predicted_rmse


def test_a_plan_within_epsilon_is_silent(wall: PlanningContext) -> None:
    within = Plan(Pose2(), 0.2, 0.004, False, (), "for a test")
    assert describe_shortfall(within, 0.01) is None
    assert describe_shortfall(replace(within, fell_back=True, viewpoint=None), 0.01) is None
    unknown = describe_shortfall(replace(within, fell_back=True, predicted_rmse=math.nan), 0.01)
    assert unknown is not None
    assert "cannot be expected" in unknown
    assert expect_accuracy(wall.session.with_plan(within)) == 0.01


def test_a_first_step_with_a_large_error_does_not_decide_what_is_accepted_later(
    wall: PlanningContext,
) -> None:
    session = wall.session
    for error in (0.083, 0.014, 0.004, math.inf, 0.012):
        session = session.with_plan(Plan(Pose2(), 0.8, error, error > 0.01, (), "for a test"))
    assert expect_accuracy(session) == 0.014


class Listener(Unobserved):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self.said.append(text)


@pytest.mark.slow
def test_the_run_says_what_it_reaches_before_it_drives() -> None:
    listener = Listener()
    config = Config.preset("best", max_views=2, planning={"epsilon": 1e-4})
    with open_sim("living_room", seed=1000) as (robot, _):
        session = digitize(robot, config, observer=listener, seed=1000)
    assert len(session.views) == 2
    warned = next(k for k, text in enumerate(listener.said) if "is below the expected" in text)
    assert warned < listener.said.index("driving to viewpoint 1")


def test_where_nothing_else_does_a_shorter_step_round_a_thing_meets_epsilon() -> None:
    small = (Box((0.9, -0.1, 0.0), (1.1, 0.1, 0.6)),)
    context = PlanningContext(session_at(small, Config(tour="full", max_views=60)))
    straight = context.find_placement(0.8).viewpoint
    assert straight is not None
    reach = math.hypot(straight.x, straight.y)

    def error(eta: float, viewpoint: Pose2) -> float:
        return 0.008 if math.hypot(viewpoint.x, viewpoint.y) < 0.8 * reach else 0.04

    plan = plan_smallest_overlap(context, error)
    assert not plan.fell_back
    assert plan.viewpoint is not None
    turn = abs(plan.viewpoint.yaw)
    assert turn == pytest.approx(0.75 * abs(straight.yaw))
    assert plan.overlap == pytest.approx(0.85)

    # A step that would leave too few views for the rest of the way is not taken
    config = replace(context.session.config, max_views=1 + math.floor(math.tau / turn))
    late = PlanningContext(replace(context.session, config=config))
    assert plan_smallest_overlap(late, error).fell_back


def test_where_no_surface_predicts_it_the_error_is_that_of_the_odometry() -> None:
    context = PlanningContext(session_at(BOX, Config(tour="full")))
    near, far = (predict_by_odometry(context, Pose2(0.0, -y, 0.5)) for y in (0.2, 0.8))
    assert 0.0 < near < far
    fine = replace(context.session.config.planning, gamma=0.0, drift=0.001, lambda_=0.001)
    config = replace(context.session.config, planning=fine)
    better = PlanningContext(replace(context.session, config=config))
    assert predict_by_odometry(better, Pose2(0.0, -0.8, 0.5)) < far
