"""The errors of one robot's odometry, learned from its registrations."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paper import paper_planning

from scan3d_twin.core.config import Config
from scan3d_twin.core.mapping.motion_model import (
    ERROR_CORRELATION,
    Evidence,
    MotionModel,
    describe_move,
    motion_prior,
)
from scan3d_twin.core.navigation.legs import Legs, assume_legs
from scan3d_twin.core.registration.pose_prior import PLANAR, shift_to_target
from scan3d_twin.core.session import Workspace
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult, read_only, wrap

CONFIG = Config()
ROBOT = np.array([0.004, 0.03, -0.015])
"""A robot that drives 0.4 % too far, drifts by 1.7 deg/m and turns by 1.5 % too little."""
MOVES: tuple[Legs, ...] = (
    ((-0.9, 1.3), (2.0, 0.0)),
    ((1.2, 0.5), (0.4, 0.6), (-1.3, 0.0)),
    ((-5.0, 0.9), (-0.4, 0.0)),
    ((0.7, 1.1), (0.3, 0.0)),
    ((2.6, 0.8), (1.0, 0.0)),
)


def follow(legs: Legs, errors: FloatArray | None = None, steps: int = 400) -> Pose2:
    """Return where ``legs`` lead for a robot with ``errors`` (c, delta, k), in small steps."""
    c, drift, k = np.zeros(3) if errors is None else errors
    here = Pose2()
    for turn, length in legs:
        here = here @ Pose2(0.0, 0.0, turn * (1 + k))
        for _ in range(steps):
            step = length / steps
            here = here @ Pose2(step * (1 + c), 0.0, drift * step)
    return here


def registered(
    T: Pose2, prior: Any, sigmas: tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
) -> RegistrationResult:
    """Return the registration that finds ``T`` with ``sigmas`` by its scans, given a ``prior``."""
    rows = np.ix_(PLANAR, PLANAR)
    shift = shift_to_target(T.matrix())[rows]
    scans = np.diag(1.0 / np.array(sigmas) ** 2)
    total = prior.information(PLANAR) + scans
    mean = Pose2.from_matrix(prior.T)
    off = np.array([T.x - mean.x, T.y - mean.y, wrap(T.yaw - mean.yaw)])
    x, y, yaw = np.linalg.solve(total, scans @ off).tolist()
    back = np.linalg.inv(shift)
    information, covariance = np.zeros((6, 6)), np.eye(6) * 1e-6
    information[rows] = back.T @ total @ back
    covariance[rows] = shift @ np.linalg.inv(total) @ shift.T
    result = RegistrationResult.unregistered(
        read_only(Pose2(mean.x + x, mean.y + y, mean.yaw + yaw).matrix()),
        read_only(covariance),
        read_only(information),
    )
    return replace(result, converged=True)


def draw_robot(rng: np.random.Generator) -> FloatArray:
    """Return the errors of a robot as configured."""
    planning = CONFIG.planning
    return rng.standard_normal(3) * [planning.lambda_, planning.drift, planning.gamma]


class _Image(SimpleNamespace):
    """The image of a view, of which a workspace keeps results."""

    __hash__ = object.__hash__


def drive(
    moves: tuple[Legs, ...],
    robot: FloatArray = ROBOT,
    config: Config = CONFIG,
    wrong: int | None = None,
    **sigmas: Any,
) -> list[Any]:
    """Return the views of a ``robot`` after ``moves``; registration ``wrong`` is 80 mm off."""
    views: list[Any] = []
    odom = Pose2()
    for k, legs in enumerate(((), *moves)):
        odom = odom @ follow(legs)
        image = _Image(stamps=np.zeros(0))
        seen = SimpleNamespace(T_odom_scan=odom, legs=legs, image=image, has_odometry=True)
        result = None
        if views:
            prior = MotionModel.of(views, config).prior(*describe_move(views[-1], seen))  # type: ignore[arg-type]
            true = follow(legs, robot)
            result = registered(
                Pose2(true.x, true.y + 0.08 * (k == wrong), true.yaw), prior, **sigmas
            )
        views.append(SimpleNamespace(observation=seen, registration=result))
    return views


@pytest.mark.parametrize("legs", MOVES)
def test_the_jacobian_is_that_of_the_move(legs: Legs) -> None:
    small = 0.01 * ROBOT
    move, true = follow(legs), follow(legs, small)
    model = replace(MotionModel.of((), CONFIG), before=(small, np.eye(3)))
    found = model.correct(move, legs)
    assert (found.x, found.y) == pytest.approx((true.x, true.y), abs=2e-6)
    assert wrap(found.yaw - true.yaw) == pytest.approx(0.0, abs=1e-9)


def test_a_long_drive_bends() -> None:
    """A heading that drifts by 0.2 rad on the way round a high thing bends it by centimetres."""
    legs: Legs = ((-0.9, 2.6), (2.2, 0.0))
    robot = np.array([0.004, 0.08, -0.015])
    move, true = follow(legs), follow(legs, robot)
    known = replace(MotionModel.of((), CONFIG), before=(robot, np.eye(3)))
    found = known.correct(move, legs)
    assert (found.x, found.y) == pytest.approx((true.x, true.y), abs=1e-3)

    # What one move teaches holds for another
    other: Legs = ((1.2, 1.5), (0.4, 1.2), (-1.5, 0.0))
    views = drive((legs,), robot)
    predicted = MotionModel.of(views, CONFIG).correct(follow(other), other)
    assert predicted.distance(follow(other, robot)) < 0.004


def test_the_constants_of_the_robot_are_learned() -> None:
    before, after = MotionModel.of((), CONFIG), MotionModel.of(drive(MOVES[:4]), CONFIG)
    assert after.mean == pytest.approx(ROBOT, abs=2.5e-3)
    sigmas = [np.sqrt(np.diag(model.covariance)) for model in (before, after)]
    assert np.all(sigmas[1][1:] < 0.25 * sigmas[0][1:])
    assert np.all(np.abs(after.mean - ROBOT) < 3 * sigmas[1])


def test_the_next_move_is_predicted_from_those_before() -> None:
    legs = MOVES[4]
    move, true = follow(legs), follow(legs, ROBOT)
    errors, spreads = [], []
    for known in (0, 1, 4):
        prior = MotionModel.of(drive(MOVES[:known]), CONFIG).prior(move, legs)
        off = prior.deviation(true.matrix())[list(PLANAR)]
        C = prior.covariance[np.ix_(PLANAR, PLANAR)]
        assert off @ np.linalg.solve(C, off) < 16.3
        errors.append(float(np.hypot(off[0], off[1])))
        spreads.append(math.sqrt(C[2, 2]))
    assert errors[2] < 0.2 * errors[0]
    assert spreads[2] < 0.3 * spreads[0]
    assert spreads[1] < spreads[0]


def test_the_prior_of_a_learned_robot_is_no_wider_than_its_moves_scatter() -> None:
    """Moves scatter by 0.6 mm and 0.05 deg about what the robot's constants make of them."""
    squares = []
    for seed in range(300):
        rng = np.random.default_rng([33, seed])
        robot, play = draw_robot(rng), rng.standard_normal(3) * [6e-4, 6e-4, math.radians(0.05)]
        prior = MotionModel.of(drive(MOVES[:4], robot), CONFIG).prior(follow(MOVES[4]), MOVES[4])
        true = follow(MOVES[4], robot)
        true = Pose2(true.x + play[0], true.y + play[1], true.yaw + play[2])
        off = prior.deviation(true.matrix())[list(PLANAR)]
        C = prior.covariance[np.ix_(PLANAR, PLANAR)]
        squares.append(float(off @ np.linalg.solve(C, off)))
    assert 0.7 < np.median(squares) < 2.4
    assert np.mean(np.array(squares) > 7.81) < 0.05


def test_what_a_workspace_keeps_changes_no_model() -> None:
    views, workspace = drive(MOVES), Workspace()
    for known in range(len(views) + 1):
        assert_same(views[:known], workspace)
    kept = [MotionModel.of(views, CONFIG, workspace).evidence for _ in range(2)]
    assert kept[0] is kept[1]

    # Another registration or odometry of the same image teaches otherwise
    other = drive(MOVES, wrong=2)[2].registration
    views[2] = SimpleNamespace(observation=views[2].observation, registration=other)
    assert_same(views, workspace)
    assert MotionModel.of(views, CONFIG, workspace).evidence.u != kept[0].u
    longer = SimpleNamespace(**{**vars(views[3].observation), "legs": ((0.7, 1.2), (0.3, 0.0))})
    views[3] = SimpleNamespace(observation=longer, registration=views[3].registration)
    assert_same(views, workspace)
    assert_same(views, workspace, replace(CONFIG, planning=replace(CONFIG.planning, drift=0.1)))


def assert_same(views: list[Any], workspace: Workspace, config: Config = CONFIG) -> None:
    """Assert that the model of ``views`` is the same with a ``workspace`` and without."""
    kept, anew = MotionModel.of(views, config, workspace), MotionModel.of(views, config)
    np.testing.assert_array_equal(kept.mean, anew.mean)
    np.testing.assert_array_equal(kept.covariance, anew.covariance)
    assert (kept.scale, kept.chi2, kept.freedom) == (anew.scale, anew.chi2, anew.freedom)


def test_turns_the_long_way_round_err_more() -> None:
    model = MotionModel.of((), CONFIG)
    move = follow(((0.5, 0.8), (0.3, 0.0)))
    sigmas = [
        math.sqrt(model.prior(move, legs).covariance[5, 5])
        for legs in (assume_legs(move), ((0.5 - math.tau, 0.8), (0.3, 0.0)))
    ]
    assert sigmas[1] > 2 * sigmas[0]


def test_turns_back_and_forth_cancel() -> None:
    """The error of a turn is undone by the turn back, which the sum of angles does not know."""
    legs = ((1.5, 0.3), (-1.5, 0.0))
    move = follow(legs)
    learned = MotionModel.of((), CONFIG).prior(move, legs)
    drawn = motion_prior(move, CONFIG.planning)
    assert learned.covariance[5, 5] < 0.5 * drawn.covariance[5, 5]


def test_a_registration_in_the_wrong_place_teaches_little() -> None:
    model = MotionModel.of(drive(MOVES[:4], wrong=4), CONFIG)
    assert model.mean == pytest.approx(ROBOT, abs=4e-3)


def test_what_the_scans_leave_open_is_not_learned() -> None:
    """A bare wall along the drive: the distance stays as configured."""
    views = drive((((0.0, 1.0), (0.0, 0.0)),) * 3, sigmas=(10.0, 1e-3, 1e-3))
    model = MotionModel.of(views, CONFIG)
    assert math.sqrt(model.covariance[0, 0]) > 0.9 * CONFIG.planning.lambda_
    assert model.mean[1] == pytest.approx(ROBOT[1], abs=3e-3)


def test_a_robot_that_errs_more_than_configured_is_found_out() -> None:
    assert MotionModel.of(drive(MOVES[:4], robot=np.zeros(3)), CONFIG).scale < 1.0
    assert MotionModel.of(drive(MOVES[:4], robot=8 * ROBOT), CONFIG).scale > 1.5


def test_the_yaw_scale_of_the_panorama_is_where_learning_begins() -> None:
    mount, registration = CONFIG.mount, CONFIG.registration
    tuned = replace(
        CONFIG,
        mount=replace(mount, yaw_scale=-0.015),
        registration=replace(registration, yaw_scale_sigma=0.002),
    )
    model = MotionModel.of((), tuned)
    assert model.mean.tolist() == [0.0, 0.0, -0.015]
    legs = MOVES[2]
    off = wrap(model.correct(follow(legs), legs).yaw - follow(legs).yaw)
    assert off == pytest.approx(0.015 * 5.4, abs=1e-6)


def test_the_paper_learns_nothing() -> None:
    config = Config.preset("paper")
    views = drive(MOVES[:3], config=config)
    model = MotionModel.of(views, config)
    move = follow(MOVES[3])
    assert model.correct(move, MOVES[3]) == move
    expected = motion_prior(move, paper_planning(), model.scale)
    for prior in (model.prior(move, MOVES[3]), model.spread(move)):
        assert np.array_equal(prior.T, expected.T)
        assert np.array_equal(prior.covariance, expected.covariance)


def test_legs_of_another_move_are_not_believed() -> None:
    views = drive(MOVES[:2])
    move, legs = describe_move(views[0], views[2].observation)
    assert legs == assume_legs(move)
    assert describe_move(views[1], views[2].observation)[1] == MOVES[1]


def test_equal_registrations_count_for_less_than_their_number() -> None:
    evidence = Evidence()
    for _ in range(6):
        evidence = evidence.add(np.eye(3), np.zeros(3), 4.0)
    assert evidence.design_effect == pytest.approx(1 + 5 * ERROR_CORRELATION)
    assert Evidence().add(np.eye(3), np.zeros(3), 4.0).design_effect == 1.0
    assert Evidence().add(np.eye(3), np.zeros(3), 0.0).design_effect == 1.0
    weak = Evidence().add(np.eye(3), np.zeros(3), 400.0).add(np.eye(3), np.zeros(3), 0.01)
    assert weak.design_effect < 1.01


def test_many_registrations_do_not_make_an_error_that_they_share_certain() -> None:
    """Each finds the robot 4 mm too far to the left, twice its own standard deviation."""
    legs, model, true = ((0.6, 0.5), (-0.3, 0.0)), MotionModel.of((), CONFIG), np.zeros(3)
    move = follow(legs)
    for _ in range(10):
        result = registered(
            Pose2(move.x, move.y + 0.004, move.yaw), model.prior(move, legs), (2e-3, 2e-3, 2e-3)
        )
        model = model.learn(move, legs, result)
    off = model.jacobian(move, legs) @ (model.mean - true)
    spread = model.jacobian(move, legs) @ model.covariance @ model.jacobian(move, legs).T
    assert abs(off[1]) > 0.001
    assert abs(off[1]) < 2.5 * math.sqrt(spread[1, 1])
