"""Odometry that turns out otherwise than scan matching, view after view."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sessions import BOX, session_at

from scan3d_twin.core.config import Config
from scan3d_twin.core.mapping.odometry_check import TurnError, measure_turn_error
from scan3d_twin.core.types import Pose2, RegistrationResult, read_only

TURNS = np.radians([40.0, -50.0, 45.0, 30.0])


@pytest.fixture(scope="module")
def start():
    """A session of a single view of a box, by the preset ``best``."""
    return replace(session_at(BOX), config=Config())


def run_of(start, scale, *, turns=TURNS, slip=0.0, panorama=0.0):
    """Return the session of a robot that turns ``scale`` more than its odometry says.

    Its last move ends ``slip`` [rad] farther still; ``panorama`` is the scale that the first
    panorama has found.
    """
    (first,) = start.views
    here, views = Pose2(), [first]
    covariance = np.diag([0.002**2] * 3 + [math.radians(0.1) ** 2] * 3)
    information = np.linalg.inv(covariance)
    for k, turn in enumerate(turns):
        here = here @ Pose2(0.3, 0.0, turn)
        true = Pose2(0.3, 0.0, turn * (1 + scale) + slip * (k == len(turns) - 1))
        result = RegistrationResult.unregistered(
            true.matrix(), read_only(covariance), read_only(information)
        )
        result = replace(result, converged=True, ambiguity_gap=1.0)
        observation = replace(first.observation, T_odom_scan=here, legs=())
        views.append(replace(first, observation=observation, registration=result))
    mount = replace(start.config.mount, yaw_scale=panorama)
    return replace(start, views=tuple(views), config=replace(start.config, mount=mount))


@pytest.mark.parametrize("scale", [0.07, -0.07, 0.098])
def test_a_wrong_model_is_measured_and_said(start, scale):
    error = measure_turn_error(run_of(start, scale))
    assert error.scale == pytest.approx(scale, abs=0.01)
    assert error.is_significant
    more = "more" if scale > 0 else "less"
    assert f"{more} than it says, by 4 measurements (1.3% is normal)" in str(error)


@pytest.mark.parametrize("scale", [0.0, 0.01, -0.02, 0.03])
def test_a_robot_as_configured_is_not_blamed(start, scale):
    assert not measure_turn_error(run_of(start, scale)).is_significant


def test_the_panorama_is_one_proof_and_a_move_the_second(start):
    assert not measure_turn_error(run_of(start, 0.07, turns=(), panorama=0.07)).is_significant
    assert measure_turn_error(run_of(start, 0.07, turns=TURNS[:1], panorama=0.07)).is_significant


def test_a_single_move_and_a_slip_are_no_proof(start):
    assert not measure_turn_error(run_of(start, 0.07, turns=TURNS[:1])).is_significant
    assert not measure_turn_error(run_of(start, 0.0, slip=0.15)).is_significant


def test_what_registration_did_not_measure_does_not_count(start):
    session = run_of(start, 0.07)
    lost = tuple(
        replace(view, registration=replace(view.registration, converged=False))
        for view in session.views[1:]
    )
    error = measure_turn_error(replace(session, views=(session.views[0], *lost)))
    assert (error.proofs, error.is_significant) == (0, False)


def test_the_limit_grows_with_what_is_not_known():
    error = partial(TurnError, scale=0.06, proofs=3)
    assert error(sigma=0.005, gamma=0.013).is_significant
    assert not error(sigma=0.02, gamma=0.013).is_significant
    assert not error(sigma=0.005, gamma=0.03).is_significant
    assert not replace(error(sigma=0.005, gamma=0.013), proofs=1).is_significant
