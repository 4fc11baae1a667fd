"""Whether a run notices that its sensor or robot errs more than assumed, and no good run does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sessions import BOX, session_at

from scan3d_twin.core.config import Config
from scan3d_twin.core.mapping.error_check import (
    FALSE_ALARMS,
    READING_SPREAD,
    SHARED_MEAN,
    SHARED_PAIR,
    SHARED_RUN,
    ErrorCheck,
    check_errors,
)
from scan3d_twin.core.types import Pose2, RegistrationResult, read_only

SIGMA = 0.004
MOVE = Pose2(0.3, 0.0, 0.5)
SHARED, ODOMETRY = "all readings share", "odometry errs"


@pytest.fixture(scope="module")
def start():
    """A session of a single view of a box with readings of 4 mm, by the preset ``best``."""
    return with_sigma(replace(session_at(BOX, sigma=SIGMA), config=Config()), SIGMA)


def with_sigma(session, sigma):
    """Return ``session`` of a sensor that has this noise when it is good [m]."""
    registration = replace(session.config.registration, reading_sigma=sigma)
    return replace(session, config=replace(session.config, registration=registration))


def run_of(start, spreads, off=0.0):
    """Return a run whose registrations have these spreads and differ from odometry by ``off``."""
    (first,) = start.views
    covariance, views, here = np.diag([0.001**2] * 6), [first], Pose2()
    for spread in spreads:
        here = here @ MOVE
        result = RegistrationResult.unregistered(
            (MOVE @ Pose2(0.0, off, 0.0)).matrix(),
            read_only(covariance),
            read_only(np.linalg.inv(covariance)),
        )
        result = replace(result, converged=True, ambiguity_gap=1.0, shared_spread=spread)
        observation = replace(first.observation, T_odom_scan=here, legs=())
        views.append(replace(first, observation=observation, registration=result))
    return replace(start, views=tuple(views))


def tells(session, words):
    """Return whether the check of ``session`` finds what ``words`` say, and nothing else."""
    found = check_errors(session)
    return len(found.findings) == 1 and words in str(found)


def test_a_run_as_assumed_says_nothing(start):
    found = check_errors(run_of(start, [1.1, 0.9, 1.2, 1.0]))
    assert found.readings == pytest.approx(1.0, abs=0.1)
    assert found.shared == pytest.approx(math.sqrt(np.mean(np.square([1.1, 0.9, 1.2, 1.0]))))
    assert found.freedom > 0
    assert not found.findings
    assert found.excess == 1.0


def test_a_sensor_noisier_than_its_kind_is_told_with_the_size(start):
    noisy = with_sigma(start, SIGMA / 2)
    assert tells(noisy, "readings scatter 1.9 times as widely")
    assert check_errors(noisy).excess == pytest.approx(2.0, rel=0.1)
    assert not check_errors(with_sigma(start, SIGMA / 1.4)).findings


def test_a_sensor_of_unknown_noise_is_not_blamed(start):
    assert math.isnan(check_errors(with_sigma(start, 0.0)).readings)


def test_large_shared_errors_are_told_the_sooner_the_more_pairs_show_them(start):
    assert tells(run_of(start, [1.6]), "share are 1.6 times the usual")
    assert not check_errors(run_of(start, [1.45])).findings
    assert tells(run_of(start, [1.45] * 5), SHARED)
    assert not check_errors(run_of(start, [math.nan])).findings


def test_odometry_off_by_much_more_than_configured_is_told(start):
    assert not check_errors(run_of(start, [1.0] * 4, off=0.002)).findings
    assert tells(run_of(start, [1.0] * 4, off=0.01), ODOMETRY)


def test_pairs_without_odometry_and_other_engines_are_not_judged(start):
    worse = run_of(start, [2.0] * 4)
    placed = replace(worse.views[1].observation, has_odometry=False)
    views = [replace(view, observation=placed) for view in worse.views]
    assert check_errors(replace(worse, views=tuple(views))).pairs == 0
    points = replace(worse.config.registration, engine="icp")
    by_points = replace(worse, config=replace(worse.config, registration=points))
    assert check_errors(by_points) == ErrorCheck()


def test_false_alarms_are_as_rare_as_stated():
    """Of runs as assumed at most 1 % are called worse, and not far fewer: it is no idle test."""
    rng, draws, freedom = np.random.default_rng(3), 4000, 8
    spread = math.hypot(SHARED_RUN, SHARED_PAIR / 2.0)
    readings = np.exp(READING_SPREAD * rng.standard_normal(draws))
    shared = np.exp(SHARED_MEAN + spread * rng.standard_normal(draws))
    odometry = np.sqrt(rng.chisquare(freedom, draws) / freedom)
    alarms = [
        bool(ErrorCheck(a, b, c, 4, freedom).findings)
        for a, b, c in zip(readings.tolist(), shared.tolist(), odometry.tolist(), strict=True)
    ]
    assert 0.5 * FALSE_ALARMS < np.mean(alarms) < 1.4 * FALSE_ALARMS
