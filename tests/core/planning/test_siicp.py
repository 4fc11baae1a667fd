from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_planning
from synthetic import Box, observe

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.planning import list_planners, make_planner
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import list_overlaps
from scan3d_twin.core.planning.planners.siicp import simulate_error
from scan3d_twin.core.planning.prediction.motion_error import (
    sample_motion_noise,
    scale_motion_error,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Plan, Pose2

pytestmark = pytest.mark.slow

WALL = (Box((1.0, -5.0, 0.0), (1.2, 5.0, 1.5)),)
STEPS = tuple(
    Box((1.0 + 0.08 * (k % 2), 1.0 - 0.2 * (k + 1), 0.0), (1.4, 1.0 - 0.2 * k, 1.0))
    for k in range(20)
)
"""A wall with pilasters every 0.2 m: full of edges."""


def session_at(boxes: tuple[Box, ...], config: Config | None = None) -> Session:
    """Return a session with a look around and one view of the wall straight ahead."""
    config = config or paper_config()
    rng = np.random.default_rng(4)
    around = observe(Pose2(), boxes, room=False, width=math.tau - 1e-3, step=math.radians(2.0))
    hint = np.column_stack([np.full(41, 1.0), np.linspace(1.0, -1.0, 41)])
    session = Session(config, 0, hint, np.array([-1.0, 0.0]), ((0, around), (1, around)))
    view = observe(Pose2(), boxes, room=False, sigma=0.004, rng=rng)
    return integrate(session, Observation(view.image, Pose2()))


@pytest.fixture(scope="module")
def wall() -> Session:
    """Return a session in front of a bare wall."""
    return session_at(WALL)


@pytest.fixture(scope="module")
def steps() -> Session:
    """Return a session in front of a wall with pilasters."""
    return session_at(STEPS)


def errors(session: Session, overlap: float, n: int, **changes: object) -> np.ndarray:
    """Return E of ``n`` draws at ``overlap``."""
    planning = replace(session.config.planning, **changes)  # type: ignore[arg-type]
    session = replace(session, config=replace(session.config, planning=planning))
    context = PlanningContext(session)
    viewpoint = context.find_placement(overlap).viewpoint
    assert viewpoint is not None
    draws = np.random.default_rng(1).standard_normal((n, 1, 3))
    rngs = np.random.default_rng(2).spawn(n)
    return np.array(
        [
            simulate_error(context, overlap, viewpoint, d, r)
            for d, r in zip(draws, rngs, strict=True)
        ]
    )


def plan(session: Session, seed: int = 0, **changes: object) -> Plan:
    """Return the plan of SiICP with changed options."""
    planning = replace(session.config.planning, **changes)  # type: ignore[arg-type]
    session = replace(session, config=replace(session.config, planning=planning))
    return make_planner("siicp").plan(session, np.random.default_rng(seed))


def test_overlaps_are_those_of_the_paper() -> None:
    assert list_overlaps(paper_planning()) == [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]


def test_the_motion_error_is_proportional_to_the_move() -> None:
    config = paper_planning(lambda_=0.02, gamma=0.01)
    error = scale_motion_error(np.array([1.0, -2.0, 3.0]), Pose2(0.5, -1.0, 0.4), config)
    assert (error.x, error.y, error.yaw) == pytest.approx((0.01, -0.04, 0.012))
    still = scale_motion_error(np.ones(3), Pose2(), config)
    assert (still.x, still.y, still.yaw) == (0.0, 0.0, 0.0)


def test_common_draws_are_the_same_for_all_overlaps_and_independent_ones_differ() -> None:
    common = sample_motion_noise(7, paper_planning(trials=3), np.random.default_rng(0))
    assert common.shape == (7, 3, 3)
    assert np.array_equal(common[0], common[6])
    config = paper_planning(trials=3, draws="independent")
    assert not np.array_equal(*sample_motion_noise(2, config, np.random.default_rng(0)))


def test_the_error_sees_a_slide_along_a_wall_and_the_residual_does_not(
    wall: Session, steps: Session
) -> None:
    on_wall, on_steps = errors(wall, 0.4, 12), errors(steps, 0.4, 12)
    assert np.median(on_wall) > 3 * np.median(on_steps)
    residuals = [np.median(errors(s, 0.4, 6, criterion="nn")) for s in (wall, steps)]
    assert residuals[0] < 1.2 * residuals[1]


def test_the_printed_equation_cannot_go_below_the_noise(steps: Session) -> None:
    sigma = 0.01
    printed = errors(steps, 0.5, 6, criterion="eq3", sigma=sigma)
    clean = errors(steps, 0.5, 6, criterion="displacement", sigma=sigma)
    assert printed.min() > 0.95 * sigma * math.sqrt(3.0)
    assert np.median(clean) < sigma


def test_a_copy_of_the_readings_is_found_again_even_on_a_bare_wall(wall: Session) -> None:
    copied = errors(wall, 0.4, 8, virtual_scan="copy")
    smoothed = errors(wall, 0.4, 8)
    assert np.median(copied) < 0.5 * np.median(smoothed)


def test_features_allow_a_smaller_overlap(wall: Session, steps: Session) -> None:
    quantile = {"trials": 8, "quantile": 0.9}
    assert plan(steps, **quantile).overlap < plan(wall, **quantile).overlap
    assert plan(wall, **quantile).overlap >= 0.7


def test_the_smallest_overlap_that_meets_epsilon_is_chosen(steps: Session) -> None:
    made = plan(steps)
    assert not made.fell_back
    assert made.predicted_rmse <= steps.config.planning.epsilon
    assert all(c.predicted_rmse > 0.01 for c in made.candidates[:-1])
    assert made.candidates[-1].overlap == made.overlap
    assert made.viewpoint == made.candidates[-1].viewpoint


def test_nothing_that_meets_epsilon_means_eighty_percent(wall: Session) -> None:
    made = plan(wall, epsilon=1e-5)
    assert made.fell_back
    assert made.overlap == 0.8
    assert len(made.candidates) == 7
    assert made.predicted_rmse == made.candidates[-1].predicted_rmse > 1e-5
    assert "80%" in made.reason


def test_a_coarser_accuracy_lets_the_robot_step_farther(wall: Session) -> None:
    fine, coarse = (plan(wall, epsilon=epsilon, trials=4) for epsilon in (0.004, 0.1))
    assert coarse.overlap == 0.2 < fine.overlap
    assert coarse.viewpoint is not None
    assert fine.viewpoint is not None
    assert coarse.viewpoint.distance(Pose2()) > fine.viewpoint.distance(Pose2())


def test_the_same_generator_gives_the_same_plan(wall: Session) -> None:
    assert plan(wall, 5) == plan(wall, 5)
    assert plan(wall, 5) != plan(wall, 6)


def test_no_look_around_yet_asks_for_one() -> None:
    session = session_at(WALL)
    seen = replace(session, panoramas=())
    made = plan(seen)
    assert made.viewpoint is None
    assert made.needs_panorama


def test_nowhere_to_go_after_looking_ends_the_run(wall: Session) -> None:
    cage = (
        Box((-0.6, -0.45, 0.0), (0.9, -0.35, 1.0)),
        Box((-0.6, 0.35, 0.0), (0.9, 0.45, 1.0)),
        Box((-0.6, -0.45, 0.0), (-0.5, 0.45, 1.0)),
    )
    around = observe(
        Pose2(), (*WALL, *cage), room=False, width=math.tau - 1e-3, step=math.radians(2.0)
    )
    made = plan(replace(wall, panoramas=((1, around),)), standoff=3.0)
    assert made.viewpoint is None
    assert not made.needs_panorama
    assert "no viewpoint left" in made.reason


def test_the_most_views_end_the_run(wall: Session) -> None:
    session = replace(wall, config=replace(wall.config, max_views=1))
    made = plan(session)
    assert made.viewpoint is None
    assert made.reason == "1 view taken (max_views)"
    twice = replace(session, views=session.views * 2, plans=session.plans * 2)
    assert plan(twice).reason == "2 views taken (max_views)"


def test_a_lost_target_ends_the_run(wall: Session) -> None:
    view = wall.views[0]
    blind = replace(view, target=view.target.select(view.target.lines < 1))
    made = plan(replace(wall, views=(blind,)))
    assert made.viewpoint is None
    assert "target lost" in made.reason


def test_an_unknown_planner_is_an_error_that_lists_the_known() -> None:
    assert "siicp" in list_planners()
    with pytest.raises(UnknownNameError, match=r"no planner 'best'; known: .*siicp"):
        make_planner("best")
