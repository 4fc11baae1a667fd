"""Clouds that do not determine the pose: what is undetermined is said, the rest keeps its variance.

``benchmarks/clouds.py --degenerate 50`` runs the same cases with more tries.
"""

from __future__ import annotations

import math

import cloud_scenes
import numpy as np
import pytest

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.registration import register
from scan3d_twin.core.registration.pose_prior import PLANAR, PosePrior, deviation, shift_to_target
from scan3d_twin.core.types import FloatArray, RegistrationResult

UNDETERMINED = {
    # name: (planar, se3)
    "floor": (3, 3),  # x, y, yaw
    "two planes": (0, 1),  # z
    "floor and wall": (1, 1),  # along the wall
    "corridor": (1, 3),  # along it; also z, and the turn about the walls' normal
    "corridor with floor": (1, 1),  # along it
    "sphere": (1, 3),  # turns about its centre
    "cylinder": (1, 2),  # the turn about its axis; also z
    "pillars": (0, 0),
    "identical": (0, 0),
}
TRIES = 3


def register_case(
    name: str, seed: int, dof: str, with_prior: bool
) -> tuple[cloud_scenes.CloudPair, FloatArray, RegistrationResult]:
    data, expected = cloud_scenes.degenerate_pair(name, seed, dof)
    sigmas = np.repeat([0.03, math.radians(1.7)], 3)
    prior = PosePrior(data.init, np.diag(sigmas**2)) if with_prior else None
    result = register(
        data.target,
        data.source,
        init_T_target_source=data.init,
        prior=prior,
        dof="planar" if dof == "planar" else "se3",
    )
    return data, expected, result


def reach_of(data: cloud_scenes.CloudPair) -> float:
    return math.sqrt(np.mean(np.sum(data.source**2, axis=1)))


@pytest.mark.parametrize("with_prior", [False, True])
@pytest.mark.parametrize("dof", ["planar", "se3"])
@pytest.mark.parametrize("name", UNDETERMINED)
def test_exactly_the_undetermined_directions_are_reported(name, dof, with_prior):
    for seed in range(TRIES):
        data, expected, result = register_case(name, seed, dof, with_prior)
        found = result.degenerate_directions
        assert len(expected) == UNDETERMINED[name][dof == "se3"]
        assert cloud_scenes.spans_agree(found, expected, reach_of(data)), (seed, found)

        # No error is larger than what is said.
        error = cloud_scenes.point_error(data.source, result.T_target_source, data.truth)
        assert error < 3 * result.predicted_rmse + 1e-6 or not result.converged
        assert math.isfinite(result.predicted_rmse) == (with_prior or len(found) == 0)
        assert result.converged == (with_prior or len(found) < (3 if dof == "planar" else 6))


def test_the_determined_directions_keep_their_variance():
    errors = []
    for seed in range(8):
        data, expected, result = register_case("floor and wall", seed, "se3", False)
        off = shift_to_target(data.truth) @ deviation(result.T_target_source, data.truth)
        errors.append(off @ result.information @ off / (6 - len(expected)))
        assert np.count_nonzero(np.linalg.eigvalsh(result.information) > 1.0) == 5
    assert 0.25 < np.mean(errors) < 4.0


def test_infinite_variance_is_where_the_direction_points():
    _, expected, result = register_case("floor and wall", 0, "planar", False)
    variances = np.diagonal(result.covariance)
    direction = np.abs(expected[0] / np.linalg.norm(expected[0]))
    assert np.isinf(variances[direction > 0.05]).all()
    assert np.isfinite(variances[[2, 3, 4]]).all()
    assert not np.isnan(result.covariance).any()
    assert math.isinf(result.predicted_rmse)
    assert expected[0] @ result.information @ expected[0] == pytest.approx(
        0.0, abs=1e-3 * np.trace(result.information)
    )
    row = np.flatnonzero(~np.isin(np.arange(6), PLANAR))
    assert not result.covariance[row].any()


def test_where_nothing_is_determined_the_guess_stays_and_is_not_called_converged():
    data, _, result = register_case("floor", 1, "planar", False)
    assert not result.converged
    assert len(result.degenerate_directions) == 3
    off = np.linalg.inv(data.init) @ result.T_target_source
    assert np.linalg.norm(off[:3, 3]) < 0.01


def test_a_direction_without_prior_stays_as_it_was_guessed():
    data, expected, result = register_case("floor and wall", 2, "planar", False)
    along = expected[0] / np.linalg.norm(expected[0])
    off = shift_to_target(data.init) @ deviation(result.T_target_source, data.init)
    assert abs(off @ along) < 0.005


@pytest.mark.parametrize("dof", ["planar", "se3"])
def test_scans_without_common_surface_do_not_converge_untruly(dof):
    untrue = 0
    for seed in range(8):
        data, _ = cloud_scenes.degenerate_pair("disjoint", seed, dof)
        try:
            result = register(data.target, data.source, init_T_target_source=data.init, dof=dof)
        except RegistrationError:
            continue
        error = cloud_scenes.point_error(data.source, result.T_target_source, data.truth)
        untrue += result.converged and error > 3 * result.predicted_rmse
    assert untrue <= 1


def test_with_several_starts_a_period_is_reported_as_ambiguous():
    """From one start nothing tells a row of pillars from the same row one pillar on."""
    for seed in range(2):
        data, _ = cloud_scenes.degenerate_pair("pillars", seed, "planar", offset=0.0, turn=0.0)
        init = data.truth.copy()
        init[:3, 3] += data.truth[:3, :3] @ [0.0, 0.55, 0.0]
        result = register(data.target, data.source, init_T_target_source=init, starts=24)
        error = cloud_scenes.point_error(data.source, result.T_target_source, data.truth)
        assert error < 0.01 or not result.converged
        assert result.ambiguity_gap < 0.1
