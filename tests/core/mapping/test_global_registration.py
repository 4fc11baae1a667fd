"""Views of a scanner that was set down by hand, in rooms whose geometry is known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import synthetic

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.global_registration import register_globally, transfer_result
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.placed_views import begin_placed_session
from scan3d_twin.core.registration import extract_surfels
from scan3d_twin.core.registration.pose_prior import displace
from scan3d_twin.core.registration.undetermined import with_infinite_variance
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2, RegistrationResult
from scan3d_twin.run.report import odometry_correction

CONFIG = Config(target=TargetConfig(extraction="everything"))
PLACES = (
    Pose2(-0.4, 0.1, 0.1),
    Pose2(0.1, -0.5, 0.7),
    Pose2(-0.9, 0.3, -0.3),
)


def observe(place: Pose2, seed: int, **scene: object) -> Observation:
    """Return a view of a scanner set down at ``place``, which nobody knows."""
    seen = synthetic.observe(
        place, width=math.radians(200), step=math.radians(1.5), sigma=0.005,
        rng=np.random.default_rng(seed), lidar=synthetic.spec(341), **scene,
    )  # fmt: skip
    return Observation(seen.image, Pose2(), has_odometry=False)


@cache
def scanned() -> Session:
    """Return the session of all places."""
    session = begin_placed_session(observe(PLACES[0], 0), CONFIG)
    for k, place in enumerate(PLACES[1:], 1):
        session = integrate(session, observe(place, k))
    return session


def test_views_without_odometry_are_found_where_they_were_taken() -> None:
    for view, place in zip(scanned().views, PLACES, strict=True):
        true = PLACES[0].inverse() @ place
        assert view.T_world_scan.distance(true) < 0.005
        assert abs(view.T_world_scan.yaw - true.yaw) < math.radians(0.2)


def test_a_result_states_errors_that_hold_and_that_it_is_unique() -> None:
    for view in scanned().views[1:]:
        result = view.registration
        assert result is not None
        assert result.converged
        assert result.ambiguity_gap > 0.2
        assert 0.0001 < result.predicted_rmse < 0.010


def test_the_pose_of_a_result_is_that_on_the_previous_view() -> None:
    views = scanned().views
    for before, view in pairwise(views):
        assert view.registration is not None
        placed = before.T_world_scan @ Pose2.from_matrix(view.registration.T_target_source)
        assert placed.distance(view.T_world_scan) < 0.01


def test_everything_is_modelled_with_the_floor() -> None:
    heights = scanned().views[0].target.points[:, 2]
    assert np.mean(np.abs(heights) < 0.02) > 0.1
    assert heights.max() > 1.0


def test_a_session_by_hand_teaches_no_odometry() -> None:
    session = scanned()
    assert np.array_equal(MotionModel.of(session.views, CONFIG).mean, np.zeros(3))
    assert all(math.isnan(value) for value in odometry_correction(session, 1))


def test_a_view_of_another_place_is_refused() -> None:
    elsewhere = (synthetic.Box((0.5, -3.0, 0.0), (0.6, 3.0, 1.0)),)
    with pytest.raises(RegistrationError, match="view 3: it fits nowhere"):
        integrate(scanned(), observe(Pose2(), 9, boxes=elsewhere, room=False))


def test_a_place_that_fits_as_well_is_named() -> None:
    """A bare square room fits as well after a quarter turn."""
    near, far, high = 1.5, 1.6, 2.5
    square = (
        synthetic.Box((near, -far, 0.0), (far, far, high)),
        synthetic.Box((-far, -far, 0.0), (-near, far, high)),
        synthetic.Box((-far, near, 0.0), (far, far, high)),
        synthetic.Box((-far, -far, 0.0), (far, -near, high)),
    )
    rng = np.random.default_rng(1)
    grids = [
        extract_surfels(
            synthetic.observe(
                place, square, width=math.radians(350), step=math.radians(1.5), sigma=0.003,
                rng=rng, lidar=synthetic.spec(341), room=False,
            ).image
        )
        for place in (Pose2(), Pose2(0.1, 0.0, math.radians(44.0)))
    ]  # fmt: skip
    found = register_globally(grids[:1], [Pose2()], grids[1])
    assert not found.is_unique
    assert found.result.ambiguity_gap < 0.05


def test_along_a_bare_wall_no_place_is_unique() -> None:
    wall = (synthetic.Box((1.0, -9.0, 0.0), (1.1, 9.0, 3.0)),)
    seen = [observe(place, k, boxes=wall, room=False) for k, place in enumerate(PLACES[:2])]
    grids = [extract_surfels(each.image, keep=each.image.heights > 0.05) for each in seen]
    assert not register_globally(grids[:1], [Pose2()], grids[1]).is_unique


def test_an_infinite_variance_stays_infinite_along_the_same_direction() -> None:
    view = scanned().views[1]
    assert view.registration is not None
    along = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    open_ = with_infinite_variance(view.registration.covariance, along, 1.0)
    result = replace(view.registration, covariance=open_, degenerate_directions=along)
    moved = transfer_result(result, Pose2(0.0, 0.0, math.pi / 2))
    assert math.isinf(moved.covariance[0, 0])
    assert math.isfinite(moved.covariance[1, 1])
    assert np.allclose(np.abs(moved.degenerate_directions), [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])


def test_a_result_moved_to_another_view_says_the_same() -> None:
    view = scanned().views[2]
    assert view.registration is not None
    T = Pose2(0.3, -1.2, 0.8)
    result = view.registration
    moved = transfer_result(result, T)

    # One standard deviation along each axis of the one is a motion that the other allows as well
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4
        before = exp_about_target(result, step)
        after = np.asarray(T.matrix() @ before)
        chi2 = step @ result.information @ step
        off = log_about_target(after @ np.linalg.inv(moved.T_target_source))
        assert off @ moved.information @ off == pytest.approx(chi2, rel=1e-3, abs=1e-9)
    assert np.allclose(moved.T_target_source, T.matrix() @ result.T_target_source)


def exp_about_target(result: RegistrationResult, step: np.ndarray) -> np.ndarray:
    """Return the pose after a small motion (6,) about the target's origin."""
    return np.asarray(displace(np.eye(4), step) @ result.T_target_source)


def log_about_target(T: np.ndarray) -> np.ndarray:
    """Return the small motion (6,) that ``T`` (4, 4) is."""
    return np.array([*T[:3, 3], T[2, 1], T[0, 2], T[1, 0]])


def test_the_same_views_give_the_same_bits() -> None:
    again = begin_placed_session(observe(PLACES[0], 0), CONFIG)
    again = integrate(again, observe(PLACES[1], 1))
    first = replace(scanned(), views=scanned().views[:2])
    assert again.views[1].registration is not None
    assert first.views[1].registration is not None
    assert np.array_equal(
        again.views[1].registration.T_target_source, first.views[1].registration.T_target_source
    )
