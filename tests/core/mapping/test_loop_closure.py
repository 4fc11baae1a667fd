"""Global alignment of views whose poses are known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from paper import paper_alignment, paper_config, paper_planning, paper_registration

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.mapping.loop_closure import (
    Alignment,
    Link,
    align,
    align_final,
    align_on_loop_closure,
    apply_alignment,
    find_misfits,
    remove_prior,
    solve_alignment,
)
from scan3d_twin.core.registration import PosePrior, extract_surfels, register
from scan3d_twin.core.registration.pose_prior import PLANAR, shift_to_target
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan, Pose2, RegistrationResult, read_only

pytestmark = pytest.mark.slow

CABINET = (
    synthetic.Box((-0.30, -0.40, 0.0), (0.30, 0.10, 0.6)),
    synthetic.Box((-0.10, 0.10, 0.0), (0.25, 0.45, 0.4)),
)
VIEWS = 10
TRUE = [
    Pose2(1.25 * math.cos(a), 1.25 * math.sin(a), a + math.pi)
    for a in np.arange(VIEWS) * math.tau / VIEWS
]
CONFIG = paper_config(
    tour="full",
    registration=paper_registration(engine="grid", scope="sweep", starts=8),
    planning=paper_planning(gamma=0.03, drift=0.04, lambda_=0.03),
)


@cache
def tour() -> Session:
    """Return a tour around a cabinet in the open, whose odometry turns too far in every move."""
    hint = TRUE[0].inverse().apply(np.array([[0.3, 0.0]]))
    session = Session(CONFIG, 1, TRUE[0].apply(hint), np.array([1.0, 0.0]))
    odom = TRUE[0]
    for k, pose in enumerate(TRUE):
        rng = np.random.default_rng(k)
        seen = synthetic.observe(
            pose, CABINET, room=False, sigma=0.005, rng=rng,
            width=math.radians(70), step=math.radians(1.0),
        )  # fmt: skip
        if k:
            move = TRUE[k - 1].inverse() @ pose
            odom = odom @ Pose2(1.01 * move.x, move.y + 0.005, move.yaw + 0.02)
        session = integrate(session, replace(seen, T_odom_scan=odom))
    return session


def error(session: Session, true: list[Pose2]) -> float:
    """Return the RMS displacement of the model, laid on the truth by its first view [m]."""
    T = true[0] @ session.views[0].T_world_scan.inverse()
    squares = [
        np.sum(((T @ view.T_world_scan).apply(points) - pose.apply(points)) ** 2, axis=1)
        for view, pose in zip(session.views, true, strict=True)
        for points in (view.target.points,)
    ]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def by_odometry(session: Session) -> Session:
    """Return ``session`` with all views placed by odometry."""
    views = [replace(v, T_world_scan=v.observation.T_odom_scan) for v in session.views]
    return replace(session, views=tuple(views))


def test_a_tour_closes() -> None:
    chained, aligned = tour(), align(tour())
    assert error(by_odometry(chained), TRUE) > 0.05
    assert error(aligned, TRUE) < 0.010
    assert error(aligned, TRUE) < 0.9 * error(chained, TRUE)
    assert aligned.views[0].T_world_scan == chained.views[0].T_world_scan


def test_the_last_view_is_linked_with_the_first_ones() -> None:
    alignment = solve_alignment(tour())
    assert any(link.target <= 1 and link.source >= VIEWS - 2 for link in alignment.links)
    assert alignment.misfits == ()
    assert alignment.views == tuple(range(VIEWS))
    assert np.all(alignment.sigmas[0] == 0.0)
    assert np.all(alignment.sigmas[1:] > 0.0)


def test_alignment_is_pure() -> None:
    one, two = align(tour()), align(tour())
    assert [v.T_world_scan for v in one.views] == [v.T_world_scan for v in two.views]
    assert len(tour().views) == VIEWS


def test_a_view_can_be_left_out() -> None:
    aligned = align(tour(), leave_out=(4,))
    assert len(aligned.views) == VIEWS - 1
    assert error(aligned, [p for k, p in enumerate(TRUE) if k != 4]) < 0.010
    with pytest.raises(ConfigError, match="no view 12"):
        align(tour(), leave_out=(12,))
    with pytest.raises(ConfigError, match="all views"):
        align(tour(), leave_out=range(VIEWS))


def test_misfits_are_those_that_most_others_contradict() -> None:
    links = [
        Link(0, 1, 1.0, 1.0),
        Link(1, 2, 40.0, 0.0),
        Link(2, 3, 50.0, 0.0),
        Link(1, 3, 2.0, 1.0),
    ]
    assert find_misfits([*links, Link(0, 3, 1.0, 1.0)]) == (2,)
    assert find_misfits([]) == ()


def configured(**alignment: str) -> Session:
    """Return the tour with these options of its alignment."""
    return replace(tour(), config=replace(CONFIG, alignment=paper_alignment(**alignment)))


def poses(session: Session) -> list[Pose2]:
    """Return the poses of all views."""
    return [view.T_world_scan for view in session.views]


def test_the_default_never_moves_a_view() -> None:
    assert align_on_loop_closure(tour()) is tour()
    assert align_final(tour()) is tour()


def test_views_are_aligned_when_the_robot_has_gone_round() -> None:
    session = configured(mode="loop_closure")
    half = replace(session, views=session.views[: VIEWS // 2])
    assert align_on_loop_closure(half) is half
    assert poses(align_on_loop_closure(session)) == poses(align(session))
    assert poses(align_final(half)) == poses(align(half))


def test_a_dropped_view_takes_its_plan_and_leaves_the_looks() -> None:
    plan = Plan(Pose2(), 0.5, 0.01, False, (), "")
    plans = tuple(replace(plan, reason=str(k)) for k in range(VIEWS))
    look = tour().views[0].observation
    session = replace(tour(), plans=plans, panoramas=((0, look), (5, look)))
    kept = tuple(k for k in range(VIEWS) if k != 4)
    poses = tuple(tour().views[k].T_world_scan for k in kept)
    found = apply_alignment(session, Alignment(kept, poses, np.zeros((9, 3)), (), (7,)))
    assert [plan.reason for plan in found.plans] == [str(k) for k in range(VIEWS) if k != 3]
    assert [taken for taken, _ in found.panoramas] == [0, 4]
    assert found.misfits == (6,)


def test_a_run_of_one_view_stays_as_it_is() -> None:
    one = replace(tour(), views=tour().views[:1])
    assert align(one).views[0].T_world_scan == one.views[0].T_world_scan


def pair() -> tuple[RegistrationResult, PosePrior, RegistrationResult]:
    """Return a registration with a strong prior that is off, the prior, and one with a weak one."""
    first, second = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
    rng = np.random.default_rng(7)
    a, b = (
        extract_surfels(synthetic.observe(pose, sigma=0.005, rng=rng).image)
        for pose in (first, second)
    )
    move = first.inverse() @ second
    off = PosePrior.planar(Pose2(move.x + 0.002, move.y - 0.003, move.yaw + 0.002), 0.0005, 0.0005)
    weak = PosePrior.planar(move, 0.1, 0.1)
    return register(a, b, prior=off), off, register(a, b, prior=weak)


def planar(result: RegistrationResult, covariance: FloatArray) -> FloatArray:
    """Return a prior's covariance (3, 3) about the target's origin."""
    shift = shift_to_target(result.T_target_source)[np.ix_(PLANAR, PLANAR)]
    return shift @ covariance[np.ix_(PLANAR, PLANAR)] @ shift.T


def test_what_the_scans_say_does_not_depend_on_the_prior() -> None:
    strong, prior, weak = pair()
    alone, information = remove_prior(strong, prior)
    pulled, free = (Pose2.from_matrix(r.T_target_source) for r in (strong, weak))
    assert pulled.distance(free) > 1e-4
    assert alone.distance(free) < 0.3 * pulled.distance(free)
    whole = strong.information[np.ix_(PLANAR, PLANAR)]
    expected = whole - np.linalg.inv(planar(strong, prior.covariance))
    assert information == pytest.approx(expected, rel=0.01, abs=1e-3 * np.abs(whole).max())


def test_an_ambiguous_pair_knows_no_more_than_its_prior() -> None:
    strong, prior, _ = pair()
    _, sure = remove_prior(strong, prior)
    _, unsure = remove_prior(replace(strong, ambiguity_gap=0.0), prior)
    doubt = np.linalg.inv(unsure) - np.linalg.inv(sure)
    assert doubt == pytest.approx(planar(strong, prior.covariance), rel=1e-6, abs=1e-12)


def test_scans_that_add_nothing_say_nothing() -> None:
    prior = PosePrior.planar(Pose2(0.1, 0.2, 0.3), 0.02, 0.03)
    shift = shift_to_target(prior.T)
    back = np.linalg.inv(shift)
    information = read_only(back.T @ np.linalg.inv(prior.covariance) @ back)
    result = RegistrationResult.unregistered(prior.T, prior.covariance, information)
    T, left = remove_prior(result, prior)
    assert left == pytest.approx(np.zeros((3, 3)), abs=1e-9)
    assert (T.x, T.y, T.yaw) == pytest.approx((0.1, 0.2, 0.3))


def test_sparing_memory_and_folding_move_no_view() -> None:
    session = tour()
    few = replace(session, views=session.views[:5], plans=session.plans[:4])
    expected = [view.T_world_scan for view in align(few).views]
    frugal = replace(few, config=replace(few.config, optimize_for="memory"))
    frugal.compress()
    assert [view.T_world_scan for view in align(frugal).views] == expected
