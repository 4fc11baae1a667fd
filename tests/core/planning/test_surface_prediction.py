from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_config
from sessions import WALL, session_at

from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.surface.surface_prediction import (
    HOLD_OUT_SHARE,
    PROFILE_STEP,
    predict_surface,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.core.viewpoints import find_predicted_segment, trace_contour

U = np.arange(0.0, 1.2, PROFILE_STEP)


def sine(u: FloatArray) -> FloatArray:
    """Return the depth of a wavy surface at ``u``."""
    return np.asarray(0.05 * np.sin(math.tau * u / 0.3))


def profile(v: FloatArray, sigma: float = 0.002) -> FloatArray:
    """Return a noisy profile (n, 2) with the depths ``v`` (n,)."""
    noise = sigma * np.random.default_rng(0).standard_normal(len(v))
    return np.column_stack([U[: len(v)], v + noise])


def test_a_wall_goes_on_as_a_plane() -> None:
    prediction = predict_surface(profile(0.3 * U))
    assert prediction is not None
    assert prediction.sigma < 0.01
    assert np.abs(prediction.points[:, 1] - 0.3 * prediction.points[:, 0]).max() < 0.02
    assert prediction.points[0, 0] > 1.15
    assert np.ptp(prediction.points[:, 0]) == pytest.approx(HOLD_OUT_SHARE * 1.2, abs=0.05)


def test_a_sine_goes_on_by_its_period() -> None:
    prediction = predict_surface(profile(sine(U)))
    assert prediction is not None
    assert prediction.name == "period"
    error = prediction.points[:, 1] - sine(prediction.points[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert prediction.sigma < 0.02


def test_a_bowl_goes_on_as_a_quadratic_patch() -> None:
    prediction = predict_surface(profile(0.4 * U**2, sigma=0.0005))
    assert prediction is not None
    assert prediction.name == "quadratic"
    assert np.abs(prediction.points[:, 1] - 0.4 * prediction.points[:, 0] ** 2).max() < 0.03


def test_an_edge_in_the_hidden_part_is_confessed() -> None:
    """The hold-out fails there, and sigma says so: no known surface predicts such an edge."""
    step = np.where(U < 0.95, 0.0, 0.3)
    prediction = predict_surface(profile(step))
    assert prediction is not None
    assert prediction.sigma > 0.1


@settings(max_examples=20)
@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
def test_the_prediction_moves_with_the_scan(yaw: float, x: float, y: float) -> None:
    T = Pose2(x, y, yaw)
    here, there = predict_surface(profile(sine(U))), predict_surface(T.apply(profile(sine(U))))
    assert here is not None
    assert there is not None
    assert there.sigma == pytest.approx(here.sigma, abs=1e-3)
    n = min(len(here.points), len(there.points)) - 1
    assert np.abs(T.apply(here.points[:n]) - there.points[:n]).max() < 0.02


def test_too_little_says_nothing() -> None:
    assert predict_surface(profile(0.0 * U)[:5]) is None
    assert predict_surface(profile(0.0 * U)[:20]) is None


def test_the_segment_lies_on_the_foreseen_surface() -> None:
    """The surface turns a right angle away just after the scan: the view goes round with it."""
    seen = np.column_stack([np.full(60, 1.0), np.linspace(0.5, -0.5, 60)])
    contour = trace_contour(seen)
    straight = np.column_stack([np.full(30, 1.0), np.linspace(-0.51, -0.8, 30)])
    away = np.column_stack([np.linspace(1.01, 1.3, 30), np.full(30, -0.5)])
    ahead, turned = (find_predicted_segment(contour, 20, 0.6, after) for after in (straight, away))
    assert ahead.normal == pytest.approx([-1.0, 0.0], abs=1e-6)
    assert turned.normal[1] < -0.3  # towards the side that comes
    assert ahead.viewpoint(1.0).y < -0.3
    assert turned.viewpoint(1.0).yaw > 0.2


@pytest.fixture(scope="module")
def wall() -> Session:
    """Return a session in front of a bare wall."""
    return session_at(WALL)


def with_prediction(session: Session, **changes: object) -> PlanningContext:
    """Return the context of ``session`` with surface prediction."""
    planning = replace(session.config.planning, foresight="holdout", **changes)  # type: ignore[arg-type]
    return PlanningContext(replace(session, config=replace(session.config, planning=planning)))


def test_foresight_is_off_unless_asked_for(wall: Session) -> None:
    assert paper_config().planning.foresight == "none"
    assert PlanningContext(wall).predicted_surface is None
    assert with_prediction(wall).predicted_surface is not None
    assert with_prediction(wall, foresight_sigma=1e-9).predicted_surface is None


def test_what_is_foreseen_is_no_overlap(wall: Session) -> None:
    plain, ahead = PlanningContext(wall), with_prediction(wall)
    assert ahead.n_lines == plain.n_lines
    assert ahead.n_Q(0.4) == plain.n_Q(0.4)
    a, b = plain.find_placement(0.4).viewpoint, ahead.find_placement(0.4).viewpoint
    assert a is not None
    assert b is not None
    assert a.distance(b) < 0.1  # a wall is what the paper's rule expects anyway
