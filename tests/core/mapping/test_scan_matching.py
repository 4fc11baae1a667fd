"""Views registered by the grid engine within a session, and what the closed form predicts of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from paper import paper_config, paper_planning, paper_registration, paper_sweep
from synthetic import ROOM, Box, observe

from scan3d_twin.core.config import Config, MountConfig, RegistrationConfig, SweepConfig
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.mapping import scan_matching, surfel_store
from scan3d_twin.core.mapping.loop_closure import align
from scan3d_twin.core.mapping.motion_prior import motion_prior
from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.registration.pose_prior import PLANAR
from scan3d_twin.core.registration.surfels.extraction import X
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Pose2,
    RegistrationResult,
    read_only,
    rms,
)

pytestmark = pytest.mark.slow

WALL = (Box((1.0, -5.0, 0.0), (1.2, 5.0, 1.5)),)
PILASTERS = tuple(
    Box((1.0 + 0.08 * (k % 2), 1.0 - 0.2 * (k + 1), 0.0), (1.4, 1.0 - 0.2 * k, 1.0))
    for k in range(20)
)


def config(scope: str = "target", **planning: float) -> Config:
    """Return a configuration of the grid engine."""
    return paper_config(
        planner="fisher",
        registration=paper_registration(engine="grid", scope=scope),  # type: ignore[arg-type]
        planning=replace(paper_planning(), **planning),  # type: ignore[arg-type]
    )


def session_at(boxes: tuple[Box, ...], settings: Config, room: bool = False) -> Session:
    """Return a session with a look around and one view of the wall straight ahead."""
    around = observe(Pose2(), boxes, room=room, width=math.tau - 1e-3, step=math.radians(2.0))
    hint = np.column_stack([np.full(41, 1.0), np.linspace(1.0, -1.0, 41)])
    session = Session(settings, 0, hint, np.array([-1.0, 0.0]), ((0, around), (1, around)))
    view = observe(Pose2(), boxes, room=room, sigma=0.004, rng=np.random.default_rng(4))
    return integrate(session, Observation(view.image, Pose2()))


def second_view(
    session: Session, boxes: tuple[Box, ...], true: Pose2, room: bool = False
) -> Session:
    """Return the session with a view from ``true``, which odometry takes for somewhere else."""
    view = observe(true, boxes, room=False, sigma=0.004, rng=np.random.default_rng(5))
    wrong = Pose2(true.x + 0.01, true.y - 0.03, true.yaw + 0.03)
    return integrate(session, Observation(view.image, wrong))


def error(session: Session, true: Pose2) -> float:
    """Return the RMS displacement of the latest view's target from its ``true`` pose [m]."""
    view = session.views[-1]
    points: FloatArray = view.target.points
    return rms(view.T_world_scan.apply(points) - true.apply(points))


@pytest.mark.parametrize("scope", ["target", "sweep"])
def test_features_fix_the_next_view(scope: str) -> None:
    true = Pose2(0.0, -0.4, 0.1)
    session = second_view(session_at(PILASTERS, config(scope)), PILASTERS, true)
    result = session.views[-1].registration
    assert result is not None
    assert result.converged
    assert error(session, true) < 0.004
    assert result.predicted_rmse < 0.010


def test_a_wall_leaves_the_slide_to_odometry() -> None:
    true = Pose2(0.0, -0.4, 0.0)
    session = second_view(session_at(WALL, config()), WALL, true)
    result = session.views[-1].registration
    assert result is not None
    assert len(result.degenerate_directions) == 1
    assert error(session, true) <= 1.1 * 0.03


@pytest.mark.parametrize("scope", ["target", "sweep"])
def test_the_surfels_of_the_latest_view_alone_are_kept_and_are_the_same(scope: str) -> None:
    session = session_at(PILASTERS, config(scope))
    for y in (0.3, 0.5):
        session = second_view(session, PILASTERS, Pose2(0.0, y, 0.0))
    results = [session.workspace.results_of(view.observation.image) for view in session.views]
    kept = [SurfelGrid in each for each in results]
    assert kept == [False, False, True]
    view = session.views[-1]
    image = replace(view.observation.image)
    anew = replace(view, observation=replace(view.observation, image=image))
    found, made = (surfels_of(each, session.config, session.workspace) for each in (view, anew))
    assert found.rows is results[-1][SurfelGrid][2]
    np.testing.assert_array_equal(found.rows, made.rows)
    np.testing.assert_array_equal(found.index, made.index)
    np.testing.assert_array_equal(found.valid, made.valid)
    assert found.noise == made.noise


def test_views_without_overlap_keep_the_odometry() -> None:
    true = Pose2(0.0, -2.6, 0.0)
    session = second_view(session_at(PILASTERS, config()), PILASTERS, true)
    view = session.views[-1]
    assert view.registration is not None
    assert not view.registration.converged
    assert view.T_world_scan == Pose2(true.x + 0.01, true.y - 0.03, true.yaw + 0.03)


def test_a_match_that_free_space_contradicts_keeps_the_odometry() -> None:
    """By odometry the robot stands one period of a short row of pilasters farther on."""
    row, wrong = PILASTERS[2:7], Pose2(0.0, 0.3, 0.0)
    view = observe(Pose2(0.0, -0.1), row, sigma=0.004, rng=np.random.default_rng(5))
    session = session_at(row, config("sweep"), room=True)
    session = integrate(session, Observation(view.image, wrong))
    result = session.views[-1].registration
    assert result is not None
    assert not result.converged
    assert result.predicted_rmse > 0.05
    assert session.views[-1].T_world_scan == wrong


def test_the_room_helps_where_the_target_does_not() -> None:
    """The bare wall stands in a room: with the whole sweep its corner fixes the slide."""
    wall = (Box((1.0, ROOM[1][0], 0.0), (1.2, 1.0, 1.5)),)
    true = Pose2(0.0, -0.3, 0.0)
    wide = replace(config("sweep"), sweep=paper_sweep(margin=math.radians(45.0)))
    errors = []
    for settings in (config("target"), wide):
        width = settings.sweep.width + 2 * settings.sweep.margin
        session = session_at(wall, settings, room=True)
        first = observe(
            Pose2(), wall, room=True, sigma=0.004, rng=np.random.default_rng(4), width=width
        )
        session = replace(session, views=())
        session = integrate(session, Observation(first.image, Pose2()))
        view = observe(
            true, wall, room=True, sigma=0.004, rng=np.random.default_rng(5), width=width
        )
        session = integrate(session, Observation(view.image, Pose2(0.01, -0.33, 0.03)))
        errors.append(error(session, true))
    assert errors[1] < 0.005 < errors[0]


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_the_motion_prior_is_that_of_turn_drive_turn(yaw: float) -> None:
    settings = paper_planning()
    move = Pose2(0.1, -0.5, yaw)
    rng = np.random.default_rng(0)
    bearing = math.atan2(move.y, move.x)
    D, n = math.hypot(move.x, move.y), 20000
    first = settings.gamma * abs(bearing) * rng.standard_normal(n)
    drift = settings.drift * D * rng.standard_normal(n)
    second = settings.gamma * abs(Pose2(0, 0, yaw - bearing).yaw) * rng.standard_normal(n)
    along = settings.lambda_ * D * rng.standard_normal(n)
    across = settings.lambda_ * D * rng.standard_normal(n) + D * first + D * drift / 2
    c, s = math.cos(bearing), math.sin(bearing)
    x, y = c * along - s * across, s * along + c * across
    prior = motion_prior(move, settings).covariance[np.ix_(PLANAR, PLANAR)]
    assert np.cov(x, y) == pytest.approx(prior[:2, :2], rel=0.1, abs=2e-5)
    assert prior[2, 2] >= np.var(first + drift + second)


def test_the_prediction_distinguishes_features_from_a_wall() -> None:
    errors = []
    for boxes in (WALL, PILASTERS):
        context = PlanningContext(session_at(boxes, config()))
        viewpoint = context.find_placement(0.7).viewpoint
        assert viewpoint is not None
        errors.append(ErrorPrediction.of(context).error(viewpoint))
    assert errors[1] < 0.005
    assert errors[0] > 3 * errors[1]


def test_the_prediction_is_what_registration_then_reports() -> None:
    session = session_at(PILASTERS, config())
    viewpoint = Pose2(0.0, -0.5, 0.2)
    predicted = ErrorPrediction.of(PlanningContext(session)).error(viewpoint)
    seen = second_view(session, PILASTERS, viewpoint)
    result = seen.views[-1].registration
    assert result is not None
    assert 0.3 < predicted / result.predicted_rmse < 2.0


def test_out_of_sight_is_no_overlap() -> None:
    context = PlanningContext(session_at(PILASTERS, config()))
    assert ErrorPrediction.of(context).error(Pose2(0.0, 0.0, math.pi)) == math.inf


def test_the_closed_form_planner_steps_farther_on_features() -> None:
    rng = np.random.default_rng(0)
    plans = [
        make_planner("fisher").plan(session_at(boxes, config()), rng) for boxes in (WALL, PILASTERS)
    ]
    assert plans[1].overlap < plans[0].overlap
    assert plans[1].predicted_rmse <= 0.010
    assert not plans[1].fell_back


def test_the_calibration_makes_it_careful() -> None:
    rng = np.random.default_rng(0)
    session = session_at(PILASTERS, config(calibration=20.0))
    assert make_planner("fisher").plan(session, rng).overlap > 0.2


@pytest.mark.parametrize(
    ("section", "values"),
    [
        (RegistrationConfig, {"starts": 0}),
        (RegistrationConfig, {"bias_sigma": -1.0}),
        (RegistrationConfig, {"yaw_scale_sigma": 2.0}),
        (SweepConfig, {"margin": -0.1}),
        (PlanningConfig, {"calibration": 0.0}),
        (PlanningConfig, {"drift": -1.0}),
    ],
)
def test_wrong_settings_are_refused(section: type, values: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        section(**values)


def test_surfels_keep_clear_of_the_floor_and_the_model_does_not() -> None:
    """Those next to the floor would lean towards it."""
    low = (Box((1.0, -0.5, 0.0), (1.2, 0.5, 0.3)),)
    session = session_at(low, config())
    view, limit = session.views[0], session.config.target.floor_height
    assert view.target.points[:, 2].min() < 0.7 * limit
    assert surfels_of(view, session.config).rows[:, X][:, 2].min() > 0.9 * limit


def test_views_with_too_little_surface_for_surfels_are_registered_by_their_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*arguments: object) -> SurfelGrid:
        raise RegistrationError("the scan shows too little surface")

    for module in (scan_matching, surfel_store):
        monkeypatch.setattr(module, "surfels_of", refuse)
    true = Pose2(0.0, -0.4, 0.1)
    session = second_view(session_at(PILASTERS, config()), PILASTERS, true)
    result = session.views[-1].registration
    assert result is not None
    assert result.converged
    assert error(session, true) < 0.005
    assert result.predicted_rmse < 0.010
    assert error(align(session), true) < 0.005

    # Odometry is kept where the points contradict each other
    monkeypatch.setattr(scan_matching, "register", lambda *a, **b: replace(result, converged=False))
    kept = second_view(session_at(PILASTERS, config()), PILASTERS, true).views[-1].registration
    assert kept is not None
    assert not kept.converged


CORNER = (Box((-0.25, -0.25, 0.0), (0.25, 0.25, 0.7)),)
"""A box in the middle, without anything around it."""


def look_at_corner(bearing: float) -> Pose2:
    """Return the pose at 1.2 m from the middle of ``CORNER`` that faces it from ``bearing``."""
    return Pose2(1.2 * math.cos(bearing), 1.2 * math.sin(bearing), bearing + math.pi)


def test_a_range_error_that_both_sweeps_share_is_predicted_to_turn_the_next_view() -> None:
    """Both faces are seen too far away, along rays that differ by the turn between the views."""
    first, second = look_at_corner(0.5), look_at_corner(1.0)
    step, offset = first.inverse() @ second, 0.005

    def sweep_from(pose: Pose2, seed: int) -> Observation:
        seen = observe(pose, CORNER, room=False, sigma=0.002, rng=np.random.default_rng(seed))
        longer = replace(seen.image, ranges=read_only(seen.image.ranges + offset))
        return Observation(longer, pose)

    settings = config("sweep")
    shared = replace(settings.registration, offset_sigma=offset, linearity_sigma=0.0)
    settings = replace(settings, registration=shared)
    session = Session(settings, 0, np.array([[0.25, 0.0], [0.0, 0.25]]), np.array([1.0, 0.0]))
    session = integrate(session, sweep_from(first, 1))

    # Predict it with and without an error that is shared
    exact = replace(settings, registration=replace(settings.registration, offset_sigma=0.0))
    predicted = [
        ErrorPrediction.of(PlanningContext(replace(session, config=each))).error(step)
        / settings.planning.calibration
        for each in (exact, settings)
    ]
    expected = math.sqrt(predicted[1] ** 2 - predicted[0] ** 2)

    # Measure it
    found = integrate(session, sweep_from(second, 2)).views[-1]
    points = found.target.points
    error = rms(found.T_world_scan.apply(points) - second.apply(points))
    assert error > 0.1 * offset
    assert expected == pytest.approx(error, rel=0.25)


STATUE = (
    Box((0.9, -0.25, 0.0), (1.2, 0.05, 0.9)),
    Box((1.1, -0.05, 0.0), (1.5, 0.3, 0.6)),
    Box((1.0, 0.0, 0.0), (1.3, 0.2, 0.75)),
)
EXCESS = 0.03
"""Share by which the base turns more than its odometry says."""


def place_at(bearing: float) -> Pose2:
    """Return the pose 1.2 m before the statue, seen from a ``bearing`` [rad]."""
    return Pose2(1.2 - 1.2 * math.cos(bearing), -1.2 * math.sin(bearing), bearing)


def walk_round(settings: Config, bearings: tuple[float, ...], seed: int = 0) -> Session:
    """Return a session of views of the statue by a base with that ``EXCESS``."""
    session = Session(settings, 0, np.array([[0.9, 0.0]]), np.array([-1.0, 0.0]))
    odometry, before = Pose2(), place_at(bearings[0])
    for k, bearing in enumerate(bearings):
        # Turn, drive and turn
        move = before.inverse() @ place_at(bearing)
        length, ahead = math.hypot(move.x, move.y), math.atan2(move.y, move.x)
        first, last = ahead / (1 + EXCESS), (move.yaw - ahead) / (1 + EXCESS)
        drive = Pose2(length * math.cos(first), length * math.sin(first), first + last)
        odometry, before = odometry @ drive, place_at(bearing)

        # Scan with the same turns
        rng = np.random.default_rng(100 * seed + k)
        image = observe(before, STATUE, room=False, sigma=0.003, rng=rng).image
        image = replace(image, yaws=read_only(image.yaws / (1 + EXCESS)))
        legs = ((first, length), (last, 0.0)) if k else ()
        session = integrate(session, Observation(image, odometry, legs=legs))
    return session


def test_sweeps_are_corrected_by_the_turns_that_registration_has_shown() -> None:
    walks, errors = 6, []
    bearings = tuple(math.radians(30.0 * k) for k in range(4))
    for seed in range(walks):
        session = walk_round(Config(), bearings, seed)
        turns = session.views[-1].turns
        assert turns is not None
        assert turns.scale == pytest.approx(EXCESS, abs=min(0.006, 3 * turns.sigma))
        for view, bearing in zip(session.views, bearings, strict=True):
            assert view.turns == turns
            yaws = view.observation.image.yaws * (1 + EXCESS)
            true = view.target.with_points_of(replace(view.image, yaws=yaws)).points
            shown = view.T_world_scan.apply(view.target.points)
            errors.append(rms(shown - place_at(bearing).apply(true)))
    assert np.all(np.reshape(errors, (walks, -1)).mean(axis=0) < 0.002), errors


def test_a_correction_of_turns_with_which_views_do_not_match_is_not_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A registration that does not settle came after one that did (random:20242, seed 20242)."""
    register_sweeps = scan_matching._register_sweeps

    def refuse_corrected(previous: View, view: View, *rest: Any) -> RegistrationResult:
        if view.turns is not None:
            raise RegistrationError("the two views contradict each other")
        return register_sweeps(previous, view, *rest)

    monkeypatch.setattr(scan_matching, "_register_sweeps", refuse_corrected)
    session = walk_round(Config(), (0.0, math.radians(30.0)))
    _, view = session.views
    assert view.turns is None
    assert view.registration is not None
    assert view.registration.converged


def test_sweeps_stay_as_they_are_where_the_look_around_has_shown_the_turns() -> None:
    settings = Config(
        mount=MountConfig(yaw_scale=EXCESS), registration=RegistrationConfig(yaw_scale_sigma=0.002)
    )
    session = walk_round(settings, (0.0, math.radians(30.0), math.radians(60.0)))
    assert [view.turns for view in session.views] == [None, None, None]
