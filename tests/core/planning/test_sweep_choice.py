"""The sector of the next sweep: as narrow as target and registration allow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sessions import BOX, PILASTERS, WALL, session_at

from scan3d_twin.core.config import Config
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.planners.fisher import FisherPlanner
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.sweep_choice import (
    SectorError,
    choose_sector,
    measure_sector,
    narrow_sweep,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2

WHOLE = math.radians(75.0)


@pytest.fixture(scope="module")
def box() -> Session:
    """Return a session in front of a box of 0.6 m, with the preset ``best``."""
    return session_at(BOX, Config(), half=0.3)


def plan_to(viewpoint: Pose2 | None, *, fell_back: bool = False) -> Plan:
    """Return a plan of 50 %."""
    return Plan(viewpoint, 0.5, 0.004, fell_back, (), "for a test")


def needs(half: float) -> SectorError:
    """Return an error within epsilon for a sweep of at least ``half`` [rad] to either side."""
    return lambda viewpoint, wanted: 0.005 if wanted >= half else 0.020


def test_a_small_target_needs_a_small_sector(box: Session) -> None:
    half, is_shown = measure_sector(PlanningContext(box), Pose2())
    assert is_shown
    extent, gap = math.atan2(0.3, 0.9), 0.2
    assert half == pytest.approx(extent + gap + math.radians(5.0), abs=math.radians(2.0))


def test_a_wide_target_needs_the_width_and_what_shows_its_end() -> None:
    wall = session_at(WALL, Config(), half=3.0)
    half, _ = measure_sector(PlanningContext(wall), Pose2())
    assert half == pytest.approx(math.radians(30.0 + 5.0) + 0.2, abs=1e-6)


def test_the_smallest_sector_within_epsilon_is_taken(box: Session) -> None:
    context, plan = PlanningContext(box), plan_to(Pose2(0.0, -0.1, 0.1))
    least, _ = measure_sector(context, Pose2(0.0, -0.1, 0.1))
    narrow = narrow_sweep(context, plan, needs(0.0))
    assert narrow.half_width == pytest.approx(least)
    assert narrow.predicted_rmse == 0.005
    between = narrow_sweep(context, plan, needs(least + 0.01)).half_width
    assert between == pytest.approx((least + WHOLE) / 2)
    assert narrow_sweep(context, plan, needs(WHOLE)) == plan


def test_the_sweep_stays_whole_where_there_is_none_or_it_is_wanted(box: Session) -> None:
    last = plan_to(None)
    assert narrow_sweep(PlanningContext(box), last, needs(0.0)) is last
    planning = replace(box.config.planning, sector="whole")
    whole = PlanningContext(replace(box, config=replace(box.config, planning=planning)))
    plan = plan_to(Pose2())
    assert narrow_sweep(whole, plan, needs(0.0)) is plan


def test_where_nothing_meets_epsilon_a_narrow_sweep_is_as_good_or_it_stays_whole(
    box: Session,
) -> None:
    context, step = PlanningContext(box), Pose2(0.0, -0.1, 0.1)
    fallen = replace(plan_to(step, fell_back=True), predicted_rmse=0.015)
    narrow = narrow_sweep(context, fallen, lambda viewpoint, half: 0.0152)
    assert narrow.half_width == pytest.approx(measure_sector(context, step)[0])
    assert narrow.predicted_rmse == 0.0152
    assert narrow_sweep(context, fallen, lambda viewpoint, half: 0.0155) is fallen
    unknown = replace(fallen, predicted_rmse=math.inf)
    assert narrow_sweep(context, unknown, lambda viewpoint, half: math.nan) is unknown


def test_of_a_target_that_goes_on_all_is_swept_where_nothing_meets_epsilon() -> None:
    """The next view is registered on what this one shows."""
    wall = session_at(WALL, Config(), half=3.0)
    step = Pose2(0.0, -0.6, 0.0)
    assert measure_sector(PlanningContext(wall), step)[1] is False
    fallen = replace(plan_to(step, fell_back=True), predicted_rmse=0.015)
    assert narrow_sweep(PlanningContext(wall), fallen, lambda viewpoint, half: 0.015) is fallen
    assert choose_sector(replace(wall, views=()), Pose2()) == (None, 0.0)


def test_the_first_sweep_ends_halfway_between_the_target_and_the_whole(box: Session) -> None:
    session = replace(box, views=())
    half, beyond = choose_sector(session, Pose2())
    own = math.atan2(0.3, 1.0) + 0.2 + math.radians(5.0)
    assert half == pytest.approx((own + WHOLE) / 2, abs=math.radians(1.0))
    assert beyond == 0.0
    planning = replace(box.config.planning, sector="whole")
    session = replace(session, config=replace(box.config, planning=planning))
    assert choose_sector(session, Pose2()) == (None, 0.0)


def test_later_sweeps_are_those_of_the_latest_plan(box: Session) -> None:
    plans = (plan_to(Pose2()), replace(plan_to(Pose2()), half_width=0.5, beyond=-0.2))
    assert choose_sector(replace(box, plans=plans), Pose2()) == (0.5, -0.2)
    assert choose_sector(replace(box, plans=plans[:1]), Pose2()) == (None, 0.0)


def test_a_narrower_sweep_is_never_predicted_to_register_better() -> None:
    prediction = ErrorPrediction.of(PlanningContext(session_at(PILASTERS, Config())))
    viewpoint = Pose2(0.0, -0.4, 0.1)
    whole = prediction.error(viewpoint)
    assert prediction.error(viewpoint, WHOLE) == whole
    errors = [prediction.error(viewpoint, math.radians(half)) for half in (25.0, 15.0, 8.0)]
    assert whole <= errors[0] * 1.01
    assert errors[0] < errors[1] < errors[2]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_sweep_goes_on_to_where_the_floor_ahead_is_not_known(
    box: Session, monkeypatch: pytest.MonkeyPatch, side: float
) -> None:
    context, step = PlanningContext(box), Pose2(0.6, side * 0.8, side * 0.1)
    assert narrow_sweep(context, plan_to(step), needs(0.0)).beyond == 0.0
    asked: list[Pose2] = []

    def is_feasible(self: PlanningContext, viewpoint: Pose2) -> bool:
        asked.append(viewpoint)
        return False

    monkeypatch.setattr(PlanningContext, "is_feasible", is_feasible)
    plan = narrow_sweep(context, plan_to(step), needs(0.0))
    assert asked[0].distance(step @ step) < 1e-9
    assert plan.half_width == pytest.approx(measure_sector(context, step)[0])
    body = math.atan2(0.8, 0.6) + math.asin(0.22) + math.radians(5.0)
    assert plan.beyond == pytest.approx(side * (min(body, WHOLE) - plan.half_width))
    context.__dict__["is_contour_done"] = True
    assert narrow_sweep(context, plan_to(step), needs(0.0)).beyond == 0.0


def test_a_view_of_hidden_surface_shows_all_that_counts(box: Session) -> None:
    context = PlanningContext(box)
    context.__dict__["is_contour_done"] = True
    assert measure_sector(context, Pose2(0.0, -0.1, 0.1))[0] == box.config.sweep.width / 2


@pytest.mark.slow
def test_the_planner_narrows_what_it_has_chosen() -> None:
    session = session_at(PILASTERS, Config())
    planning = replace(session.config.planning, epsilon=0.5)
    session = replace(session, config=replace(session.config, planning=planning))
    plan = FisherPlanner().plan(session, np.random.default_rng(0))
    assert plan.half_width is not None
    assert plan.half_width < WHOLE
    assert plan.predicted_rmse <= 0.5
