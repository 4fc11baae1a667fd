"""Registration of surfel grids against poses that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.algebra import find_determined
from scan3d_twin.core.registration.gauss_newton import MIN_PAIRS, Problem, align
from scan3d_twin.core.registration.multistart import register_grids
from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.pose_prior import (
    PosePrior,
    displace,
    predict_rmse,
)
from scan3d_twin.core.registration.surfels.extraction import N
from scan3d_twin.core.registration.surfels.grid import SurfelGrid, extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage, read_only

WALL = (synthetic.Box((1.0, -5.0, 0.0), (1.5, 5.0, 2.0)),)
FIRST, SECOND = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
MOVE = FIRST.inverse() @ SECOND
SIGMA = 0.005


def take(
    pose: Pose2, boxes: tuple[synthetic.Box, ...], seed: int, room: bool = False
) -> RangeImage:
    rng = np.random.default_rng(seed)
    return synthetic.observe(pose, boxes, room=room, sigma=SIGMA, rng=rng).image


def no_floor(image: RangeImage) -> SurfelGrid:
    with np.errstate(invalid="ignore"):
        keep = (image.points[..., 2] > 0.03) & (image.ranges < 4.0)
    return extract_surfels(image, keep=keep, noise=ScanNoise(SIGMA))


@cache
def featureful() -> tuple[SurfelGrid, SurfelGrid]:
    return (
        no_floor(take(FIRST, synthetic.THREE_BOXES, 1)),
        no_floor(take(SECOND, synthetic.THREE_BOXES, 2)),
    )


@cache
def bare_wall() -> tuple[SurfelGrid, SurfelGrid]:
    return no_floor(take(Pose2(0.0, 0.15), WALL, 1)), no_floor(take(Pose2(0.0, -0.15), WALL, 2))


def error(source: SurfelGrid, T: FloatArray, truth: Pose2 = MOVE) -> float:
    points = source.sample(4).rows[:, :3]
    moved = points @ T[:3, :3].T + T[:3, 3]
    return float(np.sqrt(np.mean(np.sum((moved - truth.apply(points)) ** 2, axis=1))))


def prior_at(pose: Pose2, xy: float = 0.02, yaw: float = 0.035) -> PosePrior:
    return PosePrior.planar(pose, xy, yaw)


@settings(max_examples=15)
@given(
    x=st.floats(-0.03, 0.03), y=st.floats(-0.03, 0.03), yaw=st.floats(-0.05, 0.05)
)  # fmt: skip
def test_recovers_any_small_motion_of_a_featureful_scan(x: float, y: float, yaw: float) -> None:
    target, source = featureful()
    guess = Pose2(MOVE.x + x, MOVE.y + y, MOVE.yaw + yaw)
    result = register_grids(target, source, prior=prior_at(guess))
    assert result.converged
    assert error(source, result.T_target_source) < 0.0015
    assert result.predicted_rmse < 0.0015
    assert len(result.degenerate_directions) == 0


@settings(max_examples=15)
@given(
    x=st.floats(-0.03, 0.03), y=st.floats(-0.03, 0.03), yaw=st.floats(-0.05, 0.05)
)  # fmt: skip
def test_on_a_wall_it_is_never_worse_than_odometry(x: float, y: float, yaw: float) -> None:
    target, source = bare_wall()
    guess = Pose2(x, -0.30 + y, yaw)
    result = register_grids(target, source, prior=prior_at(guess), starts=4)
    truth = Pose2(0.0, -0.30)
    assert error(source, result.T_target_source, truth) <= 1.05 * abs(y) + 0.002
    assert len(result.degenerate_directions) == 1
    assert abs(result.degenerate_directions[0][1]) > 0.99
    assert result.predicted_rmse == pytest.approx(0.02, rel=0.1)


def test_the_gradient_is_the_derivative_of_the_cost() -> None:
    target, source = featureful()
    gate = Gate(0.05, 1e6)  # as good as no robust kernel
    T = displace(MOVE.matrix(), np.array([0.002, -0.001, 0.001, 0.001, -0.002, 0.002]))

    def cost(step: FloatArray) -> float:
        """Sum of squares over the pairs of ``T``: the association is left as it is there."""
        return _frozen_cost(target, source, displace(T, step), T)

    gradient = linearise(target, source, 4, T, 0.0, gate).gradient[:6]
    h = 1e-6
    steps = np.eye(6) * h
    numeric = np.array([(cost(s) - cost(-s)) / (2 * h) for s in steps])
    assert gradient == pytest.approx(numeric, rel=0.03, abs=0.03 * np.abs(numeric).max())


def _frozen_cost(target: SurfelGrid, source: SurfelGrid, T: FloatArray, at: FloatArray) -> float:
    rows, table = source.sample(4).rows, target.at(np.s_[:, :]).reshape(-1, 8)
    frozen = rows[:, :3] @ at[:3, :3].T + at[:3, 3]
    index = target.projection.lookup(frozen, table[:, 6] > 0)
    q, n_t = table[index, :3], table[index, 3:6]
    n_s = rows[:, 3:6] @ at[:3, :3].T
    n = n_s + n_t
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    moved = rows[:, :3] @ T[:3, :3].T + T[:3, 3]
    alike = (np.sum(n_s * n_t, axis=1) - 0.7) / 0.3
    good = (index >= 0) & (table[index, 6] > 0) & (alike > 0)
    good &= np.abs(np.sum(n * (frozen - q), axis=1)) < 0.05
    good &= np.sum((frozen - q) ** 2, axis=1) < 0.15**2
    e = np.sum(n * (moved - q), axis=1)[good]
    w = 16.0 * alike[good] ** 2 / (rows[good, 6] + table[index[good], 6])
    return float(0.5 * np.sum(w * e * e))


def test_pairs_count_less_the_more_their_normals_differ() -> None:
    """A pair's normal is a unit vector, so that the trace of the first block sums the weights."""
    target, source = bare_wall()
    gate = Gate(0.05, 1e6, math.cos(math.radians(30.0)))
    weights = {}
    for degrees in (0.0, 20.0, 40.0):
        turned = Pose2(0.0, 0.0, math.radians(degrees)).rotate(source.rows[:, N])
        rows = np.concatenate([source.rows[:, :3], turned, source.rows[:, 6:]], axis=1)
        found = linearise(
            target, replace(source, rows=read_only(rows)), 4, Pose2(0.0, -0.30).matrix(), 0.0, gate
        )
        weights[degrees] = float(np.trace(found.information[:3, :3]))
    share = (math.cos(math.radians(20.0)) - gate.cosine) / (1.0 - gate.cosine)
    assert weights[20.0] / weights[0.0] == pytest.approx(share**2, rel=0.2)
    assert weights[40.0] < 0.01 * weights[0.0]


def test_the_covariance_is_that_of_many_registrations() -> None:
    errors, predicted = [], []
    for seed in range(12):
        target = no_floor(take(FIRST, synthetic.THREE_BOXES, 100 + seed))
        source = no_floor(take(SECOND, synthetic.THREE_BOXES, 200 + seed))
        result = register_grids(target, source, prior=prior_at(MOVE))
        errors.append(error(source, result.T_target_source))
        predicted.append(result.predicted_rmse)
    assert 0.6 < float(np.median(predicted)) / math.sqrt(np.mean(np.square(errors))) < 1.5


def test_six_degrees_of_freedom_with_a_prior() -> None:
    target, source = featureful()
    T = displace(MOVE.matrix(), np.array([0.01, -0.02, 0.0, 0.0, 0.0, 0.02]))
    prior = PosePrior(read_only(T), prior_at(MOVE).covariance)
    result = register_grids(target, source, prior=prior, dof="se3")
    assert error(source, result.T_target_source) < 0.002
    assert abs(result.T_target_source[2, 3]) < 0.002
    assert result.information.shape == (6, 6)


def test_a_direction_without_any_information_is_not_determined() -> None:
    H = np.diag([4.0, 0.0, 1.0])
    kept, honest, dropped = find_determined(H, np.zeros((3, 3)), 1.0)
    assert kept == pytest.approx(np.diag([1.0, 0.0, 1.0]))
    assert honest == pytest.approx(kept)
    assert np.abs(dropped) == pytest.approx(np.array([[0.0, 1.0, 0.0]]))
    nothing = find_determined(np.zeros((3, 3)), np.zeros((3, 3)), 1.0)
    assert not nothing[0].any()
    assert len(nothing[2]) == 3


def test_a_wrong_wheel_base_is_found_from_two_sweeps() -> None:
    """Yaws 2 % too large bend both scans; the room knows better."""
    wrong = 0.02
    images = [
        take(pose, synthetic.THREE_BOXES, k, room=True) for k, pose in enumerate((FIRST, SECOND))
    ]
    grids = []
    for image in images:
        keep = (image.points[..., 2] > 0.03) & (image.ranges < 4.0)
        bent = replace(image, yaws=read_only(image.yaws * (1 + wrong)))
        noise = ScanNoise(SIGMA, yaw_scale_sigma=0.02)
        grids.append(extract_surfels(bent, keep=keep, noise=noise))
    problem = Problem(grids[0], grids[1], prior_at(MOVE))
    assert align(problem, MOVE.matrix()).yaw_scale == pytest.approx(-wrong, abs=0.006)


def test_yaw_jitter_widens_the_covariance() -> None:
    target, source = featureful()
    shaken = (replace(g, noise=replace(g.noise, yaw_sigma=0.003)) for g in (target, source))
    calm = register_grids(target, source, prior=prior_at(MOVE))
    rough = register_grids(*shaken, prior=prior_at(MOVE))
    assert rough.predicted_rmse > 1.3 * calm.predicted_rmse


@pytest.mark.parametrize("swap", [False, True])
def test_no_overlap_is_an_error_whichever_scan_is_the_target(swap: bool) -> None:
    pair = featureful()
    target, source = pair[::-1] if swap else pair
    with pytest.raises(RegistrationError, match="no overlap"):
        register_grids(target, source, init_T_target_source=Pose2(0, 9, 2.0).matrix())
    with pytest.raises(RegistrationError, match="no overlap"):
        register_grids(target, source, prior=prior_at(Pose2(0, 9, 2.0)), starts=4)


def test_an_overlap_too_narrow_for_thinned_surfels_is_registered_from_the_prior() -> None:
    """The rough steps of several starts take every 8th line and beam: 9 of the patch's readings."""
    target, source = featureful()
    line, beam = (int(np.median(at)) for at in np.nonzero(source.index >= 0))
    patch = np.full_like(source.index, -1)
    around = np.s_[line - 12 : line + 12, beam - 12 : beam + 12]
    patch[around] = source.index[around]
    thin = Problem(target, replace(source, index=patch)).make_source(2)
    assert 0 < thin.coarse.count < MIN_PAIRS
    small = replace(source, index=patch)
    alone = register_grids(target, small, prior=prior_at(MOVE))
    several = register_grids(target, small, prior=prior_at(MOVE), starts=4)
    assert np.array_equal(several.T_target_source, alone.T_target_source)
    assert math.isnan(several.ambiguity_gap)


def test_what_a_large_sweep_shares_with_a_small_one_is_found() -> None:
    """A box of 40 cm and, from round its corner, its room too: every 4th line and beam of that."""
    box = (synthetic.Box((0.9, -0.2, 0.0), (2.1, 0.2, 0.35)),)
    pose, rng = Pose2(0.6, -1.0, math.radians(70.0)), np.random.default_rng(2)
    wide = synthetic.observe(pose, box, width=math.radians(120.0), sigma=SIGMA, rng=rng).image
    target, source = no_floor(take(Pose2(), box, 1)), no_floor(wide)
    assert target.count < 0.05 * source.count
    prior = prior_at(Pose2(0.01, -0.01, 0.02) @ pose)
    with pytest.raises(RegistrationError, match="no overlap"):
        align(Problem(target, source, prior), prior.T)
    result = register_grids(target, source, prior=prior, starts=16)
    assert result.converged
    off = Pose2.from_matrix(result.T_target_source) @ pose.inverse()
    assert abs(off.x) < 0.001
    assert abs(off.yaw) < 3 * math.sqrt(result.covariance[5, 5])


def test_bad_options_are_refused() -> None:
    target, source = featureful()
    with pytest.raises(ConfigError, match="finite"):
        register_grids(target, source, init_T_target_source=np.full((4, 4), np.nan))
    with pytest.raises(ConfigError, match="prior"):
        register_grids(target, source, starts=8)
    with pytest.raises(ConfigError, match="starts"):
        register_grids(target, source, starts=0)
    with pytest.raises(ConfigError, match="dof"):
        register_grids(target, source, dof="all")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="positive definite"):
        PosePrior(np.eye(4), np.zeros((6, 6)))
    with pytest.raises(ConfigError, match="pose"):
        PosePrior(np.full((4, 4), np.nan), np.eye(6))


def test_without_prior_the_unknown_direction_keeps_the_guess() -> None:
    target, source = bare_wall()
    guess = Pose2(0.01, -0.27, 0.01)
    result = register_grids(target, source, init_T_target_source=guess.matrix())
    assert result.T_target_source[1, 3] == pytest.approx(guess.y, abs=0.004)
    assert abs(result.T_target_source[0, 3]) < 0.002
    assert len(result.degenerate_directions) == 1


def test_spread_is_the_mean_displacement() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 6)) * 0.01
    points = rng.normal(size=(200, 3))
    draws = rng.standard_normal((4000, 6)) @ half.T
    moved = draws[:, None, :3] + np.cross(draws[:, None, 3:], points[None])
    numeric = np.sqrt(np.mean(np.sum(moved**2, axis=2)))
    assert predict_rmse(points, half @ half.T) == pytest.approx(numeric, rel=0.03)


def test_a_step_at_the_solution_is_nothing() -> None:
    target, source = featureful()
    problem = Problem(target, source, prior_at(MOVE))
    outcome = align(problem, MOVE.matrix())
    assert outcome.settled
    again = align(problem, outcome.T)
    assert np.abs(again.T - outcome.T).max() < 1e-4


@pytest.mark.parametrize("shift", [0.02, 0.05, 0.15])
def test_a_thing_that_moved_between_two_scans_does_not_drag_the_rest(shift: float) -> None:
    """A pillar before the boxes, a third of the surfels, comes nearer by ``shift`` [m]."""
    errors = []
    for seed in range(3):
        pillars = [
            synthetic.Box((0.5 - by, -0.035, 0.0), (0.6 - by, 0.035, 0.9)) for by in (0.0, shift)
        ]
        target, source = (
            no_floor(take(pose, (*synthetic.THREE_BOXES, pillar), seed + k, room=True))
            for k, (pose, pillar) in enumerate(zip((FIRST, SECOND), pillars, strict=True))
        )
        result = register_grids(target, source, prior=prior_at(MOVE), starts=16)
        errors.append(error(source, result.T_target_source))
    assert max(errors) < 0.002
