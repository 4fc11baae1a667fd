"""Virtual scans of what would be seen, and registrations simulated on them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_planning, paper_registration
from sessions import BOX, PILASTERS, WALL, session_at
from synthetic import Box, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.motion_prior import motion_prior
from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.planning.context import PlanningContext, mask_readings
from scan3d_twin.core.planning.prediction.simulated_registration import (
    SimulatedRegistration,
    displace_prior,
)
from scan3d_twin.core.planning.prediction.virtual_scan import DrawnNoise, Planes, Surface
from scan3d_twin.core.planning.surface.visibility import NextSweep
from scan3d_twin.core.registration.pose_prior import PLANAR
from scan3d_twin.core.registration.surfels import grid as surfel_grid
from scan3d_twin.core.registration.surfels.extraction import N
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2

pytestmark = pytest.mark.slow

CONFIG = paper_config(
    registration=paper_registration(engine="grid", starts=4),
    planning=paper_planning(
        virtual_scan="visible", trials=6, quantile=0.7, lambda_=0.03, gamma=0.005, drift=0.01
    ),
)
O2 = Pose2(0.0, -0.25, 0.05)


def surface_of(session: Session) -> Surface:
    view = session.views[-1]
    grid = surfels_of(view, session.config)
    return Surface(grid, mask_readings(view.target, view.image), 4.0)


def seen_from(surface: Surface, viewpoint: Pose2) -> Planes:
    return surface.seen_from(viewpoint, NextSweep.like(surface.grid, math.radians(30.0)))


def silent(surface: Surface) -> DrawnNoise:
    noise = replace(surface.grid.noise, range_sigma=1e-4, range_sigma_per_metre=0.0)
    return DrawnNoise(replace(noise, yaw_sigma=0.0, bias_sigma=0.0), 0.0)


@pytest.fixture(scope="module")
def wall() -> Session:
    return session_at(WALL, CONFIG)


@pytest.fixture(scope="module")
def pilasters() -> Session:
    return session_at(PILASTERS, CONFIG)


@pytest.mark.parametrize("viewpoint", [Pose2(), O2, Pose2(0.2, 0.3, -0.2)])
def test_a_virtual_scan_reads_what_a_real_one_would(wall: Session, viewpoint: Pose2) -> None:
    surface = surface_of(wall)
    planes = seen_from(surface, viewpoint)
    true = observe(viewpoint, WALL, room=False).image
    read = planes.ranges(planes.image)
    both = planes.keep & np.isfinite(true.ranges[: len(read)])
    assert np.count_nonzero(both) > 2000
    off = (read - true.ranges[: len(read)])[both]
    assert np.sqrt(np.mean(off**2)) < 0.003
    assert abs(float(np.mean(off))) < 0.001


def test_unseen_surface_stays_unknown(wall: Session) -> None:
    """From O2 the wall goes on to the right, where the latest view saw nothing."""
    planes = seen_from(surface_of(wall), Pose2(0.0, -0.8, 0.0))
    right = planes.image.yaws[:, 0] < -math.radians(5.0)
    assert not planes.met[right].any()
    assert not planes.empty[right].any()
    assert planes.met[~right].any()


def test_what_hides_behind_a_thing_is_not_seen() -> None:
    post = Box((0.5, -0.25, 0.0), (0.6, -0.15, 1.5))
    session = session_at((*WALL, post), CONFIG)
    surface = surface_of(session)
    planes = seen_from(surface, Pose2(0.0, -0.2, 0.0))
    middle = np.abs(planes.image.yaws[:, 0]) < math.radians(4.0)
    level = np.abs(planes.image.spec.elevations) < 0.1
    ranges = planes.ranges(planes.image)[np.ix_(middle, level)]
    assert np.nanmedian(ranges) == pytest.approx(0.45, abs=0.02)


def test_rays_the_latest_view_saw_through_are_empty() -> None:
    surface = surface_of(session_at(BOX, CONFIG, half=0.3))
    planes = seen_from(surface, Pose2(0.0, -0.1, 0.0))
    ahead = np.abs(planes.image.yaws[:, 0]) < math.radians(10.0)
    over, at = (
        np.abs(planes.image.spec.elevations - math.radians(angle)) < 0.05 for angle in (40.0, 10.0)
    )
    assert planes.empty[np.ix_(ahead, over)].mean() > 0.9
    assert not planes.empty[np.ix_(ahead, at)].any()
    assert not (planes.empty & planes.met).any()


def test_noise_is_as_strong_as_registration_takes_it_to_be(wall: Session) -> None:
    surface = surface_of(wall)
    planes, rng = surface.here, np.random.default_rng(0)
    assumed = replace(surface.grid.noise, bias_sigma=0.0, yaw_sigma=0.0)
    clean = planes.ranges(planes.image)
    noisy = planes.read(DrawnNoise(assumed, 0.0), rng).image.ranges
    sigma = assumed.range_sigma + assumed.range_sigma_per_metre * clean
    assert np.nanstd((noisy - clean) / sigma) == pytest.approx(1.0, rel=0.05)
    biased = DrawnNoise(replace(assumed, bias_sigma=0.02), 0.0)
    spread = [np.nanstd(planes.read(biased, rng).image.ranges - clean) for _ in range(20)]
    assert np.sqrt(np.mean(np.square(spread))) == pytest.approx(0.02, rel=0.25)


def test_yaw_errors_move_whole_lines(wall: Session) -> None:
    surface = surface_of(wall)
    planes, noise = surface.here, silent(surface)
    shaken = replace(noise, assumed=replace(noise.assumed, yaw_sigma=0.01))
    read = planes.read(shaken, np.random.default_rng(0)).image
    level = np.abs(read.spec.elevations) < 0.05
    off = (read.ranges - planes.ranges(planes.image))[:, level]
    between, within = np.nanstd(np.nanmean(off, axis=1)), np.nanmean(np.nanstd(off, axis=1))
    assert between > 3 * within


def test_the_little_noise_left_in_the_planes_does_not_look_like_features(wall: Session) -> None:
    surface = surface_of(wall)
    table = surface.here
    ours = table.normals[table.keep[table.met]][:, 1]
    fitted = surface.grid.rows[:, N][:, 1]
    assert np.std(ours) < 0.5 * np.std(fitted)


def test_draws_follow_the_motion_prior() -> None:
    prior = motion_prior(Pose2(0.1, -0.6, 0.2), CONFIG.planning)
    rng = np.random.default_rng(0)
    moved = [
        Pose2.from_matrix(displace_prior(prior, rng.standard_normal(3)).T) for _ in range(4000)
    ]
    found = np.cov([[p.x for p in moved], [p.y for p in moved], [p.yaw for p in moved]])
    expected = prior.covariance[np.ix_(PLANAR, PLANAR)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert found / scale == pytest.approx(expected / scale, abs=0.08)


def test_candidates_meet_the_same_draws_and_seeds_differ(pilasters: Session) -> None:
    def errors(seed: int) -> list[float]:
        return list(SimulatedRegistration.of(PlanningContext(pilasters), seed).errors(O2, 2))

    assert errors(1) == errors(1)
    assert errors(1) != errors(2)


def test_a_slide_shows_on_a_wall_and_not_on_features(wall: Session, pilasters: Session) -> None:
    median = []
    for session in (wall, pilasters):
        errors = list(SimulatedRegistration.of(PlanningContext(session), 3).errors(O2, 5))
        median.append(float(np.median(errors)))
    assert median[1] < 0.005
    assert median[0] > 1.5 * median[1]


def test_wrong_basins_show_as_large_errors() -> None:
    """Ribs every 6 cm, odometry of 5 cm: the closed form trusts them, simulation does not."""
    ribs = tuple(
        Box((1.0 + 0.02 * (k % 2), 2.0 - 0.03 * (k + 1), 0.0), (1.3, 2.0 - 0.03 * k, 1.0))
        for k in range(130)
    )
    poor = replace(CONFIG, planning=replace(CONFIG.planning, lambda_=0.12))
    session = session_at(ribs, poor)
    errors = list(
        SimulatedRegistration.of(PlanningContext(session), 0).errors(Pose2(0.0, -0.45, 0.0), 5)
    )
    assert max(errors) > 0.03


def test_out_of_sight_is_infinite(wall: Session) -> None:
    simulation = SimulatedRegistration.of(PlanningContext(wall), 0)
    assert simulation.error(Pose2(0.0, 0.0, math.pi), 3) == math.inf


def test_a_simulated_scan_that_shows_too_little_keeps_the_odometry(
    wall: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a view with few surfels its own simulation may show fewer than a registration needs."""
    simulation = SimulatedRegistration.of(PlanningContext(wall), 0)
    monkeypatch.setattr(surfel_grid, "MIN_SURFELS", simulation.grid.count + 1)

    errors = list(simulation.errors(O2, 5))

    moves = MotionModel.of((), CONFIG).spread(O2)
    typical = math.hypot(*np.sqrt(np.diagonal(moves.covariance)[[0, 1]]))
    assert len(set(errors)) == 5
    assert 0.1 * typical < min(errors) <= max(errors) < 5 * typical


def test_the_visible_planner_takes_the_smallest_overlap_that_stands_its_draws(
    pilasters: Session,
) -> None:
    plan = make_planner("siicp").plan(pilasters, np.random.default_rng(1))
    assert not plan.fell_back
    assert plan.predicted_rmse <= CONFIG.planning.epsilon
    assert all(c.predicted_rmse > CONFIG.planning.epsilon for c in plan.candidates[:-1])


def test_checks_send_the_closed_form_on_to_a_larger_overlap(
    pilasters: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(CONFIG, planner="fisher", planning=replace(CONFIG.planning, checks=3))
    session = replace(pilasters, config=config)
    asked: list[Pose2] = []

    def contradict(
        self: SimulatedRegistration, viewpoint: Pose2, draws: int, half: float | None = None
    ) -> float:
        asked.append(viewpoint)
        return 0.05 if len(asked) == 1 else 0.001

    monkeypatch.setattr(SimulatedRegistration, "error", contradict)
    plan = make_planner("fisher").plan(session, np.random.default_rng(0))
    assert len(asked) == 2
    assert plan.candidates[-2].predicted_rmse == 0.05
    assert plan.overlap > plan.candidates[-2].overlap
    assert plan.predicted_rmse <= config.planning.epsilon


def test_visible_scans_need_the_grid_engine() -> None:
    with pytest.raises(ConfigError, match=r"registration\.engine = grid"):
        paper_config(planning=paper_planning(virtual_scan="visible"))


def test_odometry_that_errs_more_than_configured_is_found_out() -> None:
    """Two moves of 0.3 m that odometry misjudges by nothing, and by far more than configured."""
    scales = []
    for off in (0.0, 0.06):
        session = session_at(PILASTERS, CONFIG)
        views = session_with_moves(session, off)
        scales.append(MotionModel.of(views.views, CONFIG).scale)
    assert scales[0] < 1.0 < 2.0 < scales[1]
    assert MotionModel.of((), CONFIG).scale == 1.0


def session_with_moves(session: Session, off: float) -> Session:
    """Return the session with two more views, the odometry of each off by ``off`` [m] more."""
    rng = np.random.default_rng(1)
    for k in (1, 2):
        true = Pose2(0.0, -0.25 * k, 0.0)
        image = observe(true, PILASTERS, room=False, sigma=0.004, rng=rng).image
        measured = Pose2(true.x + off * k, true.y, true.yaw)
        session = integrate(session, Observation(image, measured))
    return session


def test_the_prediction_of_a_registration_is_about_the_target(pilasters: Session) -> None:
    view = session_with_moves(pilasters, 0.0).views[-1]
    result = view.registration
    assert result is not None
    points = Pose2.from_matrix(result.T_target_source).apply(view.target.points)
    S = result.covariance
    J = np.zeros((len(points), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -points[:, 1], points[:, 0]
    C = S[np.ix_(PLANAR, PLANAR)]
    variance = np.einsum("nij,jk,nik->n", J, C, J)
    assert result.predicted_rmse == pytest.approx(float(np.sqrt(variance.mean())), rel=1e-6)


def test_sparing_memory_changes_no_error(wall: Session) -> None:
    config = replace(CONFIG, optimize_for="memory")
    frugal, usual = (
        SimulatedRegistration.of(PlanningContext(replace(wall, config=each)), 3)
        for each in (config, CONFIG)
    )
    for viewpoint in (O2, Pose2(0.0, -0.3, 0.0)):
        errors = [list(each.errors(viewpoint, 2)) for each in (frugal, usual)]
        assert errors[0] == errors[1]
    assert (len(frugal._scans), len(usual._scans)) == (0, 2)


def test_scans_from_here_serve_sweeps_of_any_sector(pilasters: Session) -> None:
    """A narrower sweep changes what is read from O2 only: the draws and scans from here stay."""
    simulation = SimulatedRegistration.of(PlanningContext(pilasters), seed=3)
    whole = list(simulation.errors(O2, 3))
    narrow = list(simulation.errors(O2, 3, math.radians(15.0)))
    fresh = SimulatedRegistration.of(PlanningContext(pilasters), seed=3)
    assert narrow == list(fresh.errors(O2, 3, math.radians(15.0)))
    assert narrow != whole
    assert whole == list(simulation.errors(O2, 3))
