"""Sweeps that do not determine the pose: what is undetermined is said.

``benchmarks/degenerate_sweeps.py`` runs all cases with more tries.
"""

from __future__ import annotations

import math
from functools import cache

import cloud_scenes
import numpy as np
import pytest
from degenerate_pairs import PRIOR_XY, PRIOR_YAW, SweepPair, draw_pair

from scan3d_twin.core.registration import register
from scan3d_twin.core.registration.pose_prior import PLANAR, PosePrior
from scan3d_twin.core.registration.surfels.grid import extract_surfels
from scan3d_twin.core.types import Pose2

UNDETERMINED = {
    "two planes": 0,
    "floor and wall": 1,  # along the wall
    "corridor with floor": 1,  # along it
    "corridor": 1,  # along it; the walls are as long as the range of the lidar
    "sphere": 1,  # the turn about its centre
    "cylinder": 1,  # the turn about its axis
}
TRIES = 2


@cache
def take(name: str, seed: int) -> SweepPair:
    return draw_pair(name, seed)


@pytest.mark.parametrize("with_prior", [False, True])
@pytest.mark.parametrize("name", UNDETERMINED)
def test_exactly_the_undetermined_directions_are_reported(name: str, with_prior: bool) -> None:
    for seed in range(TRIES):
        pair = take(name, seed)
        prior = PosePrior.planar(pair.init, PRIOR_XY, PRIOR_YAW) if with_prior else None
        result = register(pair.target, pair.source, prior=prior, init_T_target_source=pair.init)
        points = pair.source.points[np.isfinite(pair.source.ranges)]
        reach = math.sqrt(np.mean(np.sum(points**2, axis=1)))
        found = result.degenerate_directions
        assert len(pair.directions) == UNDETERMINED[name]
        assert cloud_scenes.spans_agree(found, pair.directions, reach), (seed, found)

        # No error is larger than what is said.
        error = cloud_scenes.point_error(points, result.T_target_source, pair.truth.matrix())
        assert error < 3 * result.predicted_rmse
        assert math.isfinite(result.predicted_rmse) == (with_prior or len(found) == 0)


@pytest.mark.parametrize("with_prior", [False, True])
def test_sweeps_of_opposite_sides_are_not_taken_for_one(with_prior: bool) -> None:
    """They match, as rooms are symmetric; what stands in them does not."""
    for seed in range(10):
        pair = take("disjoint", seed)
        prior = PosePrior.planar(pair.init, PRIOR_XY, PRIOR_YAW) if with_prior else None
        result = register(pair.target, pair.source, prior=prior, init_T_target_source=pair.init)
        assert not result.converged, seed


@pytest.mark.parametrize(("seed", "is_right"), [(0, True), (1, True), (71, False), (95, False)])
def test_pillars_on_others_are_not_believed(seed: int, is_right: bool) -> None:
    """The guess of two pairs is so far off that some pillars are laid on their neighbours."""
    pair = take("pillars", seed)
    prior = PosePrior.planar(pair.init, PRIOR_XY, PRIOR_YAW)
    result = register(pair.target, pair.source, prior=prior)
    points = pair.source.points[np.isfinite(pair.source.ranges)]
    error = cloud_scenes.point_error(points, result.T_target_source, pair.truth.matrix())
    assert (error < 0.002) == is_right
    assert result.converged == is_right


def test_pillars_have_the_stated_variance() -> None:
    """Their ends are no yaw jitter, which would make yaw and slide too uncertain.

    Squares are capped at two standard deviations, as some pairs end in another period; normal
    errors keep .92 of their mean square.
    """
    ratios = []
    for seed in range(60):
        pair = take("pillars", seed)
        prior = PosePrior.planar(pair.init, PRIOR_XY, PRIOR_YAW)
        result = register(pair.target, pair.source, prior=prior)
        off = Pose2.from_matrix(result.T_target_source) @ pair.truth.inverse()
        variances = np.diag(result.covariance[np.ix_(PLANAR, PLANAR)])
        ratios.append(np.square([off.x, off.y, off.yaw]) / variances)
    found = np.minimum(ratios, 4.0).mean(axis=0) / 0.92
    assert np.all(found > 1 / 3), found
    assert np.all(found < 1.5), found


def test_a_bare_floor_determines_nothing() -> None:
    """The turn is the hardest: normals of a floor err most about the trace of the ray."""
    for seed in range(10):
        pair = take("floor", seed)
        result = register(pair.target, pair.source, init_T_target_source=pair.init)
        assert len(result.degenerate_directions) == 3, seed
        assert not result.converged


@pytest.mark.parametrize("name", ["cylinder", "sphere"])
def test_round_bodies_have_the_stated_variance(name: str) -> None:
    """Planes lie inside them, by how much depends on the noise: the same in both sweeps."""
    errors, variances = [], []
    for seed in range(30):
        pair = take(name, seed)
        result = register(pair.target, pair.source, init_T_target_source=pair.init)
        points = pair.source.points[np.isfinite(pair.source.ranges)]
        error, variance = cloud_scenes.compare_determined(
            result, pair.truth.matrix(), pair.directions, points, PLANAR
        )
        errors.append(error)
        variances.append(variance)
    ratios = np.mean(np.square(errors), axis=0) / np.mean(variances, axis=0)
    assert len(ratios) == 2
    assert np.all(ratios < 2.0), ratios
    assert np.all(ratios > 0.25), ratios


def test_a_wall_that_the_range_of_the_lidar_ends_has_no_edge() -> None:
    """That edge would lie elsewhere from each viewpoint, and hide that the wall may slide."""
    for seed in range(TRIES):
        assert len(extract_surfels(take("corridor", seed).target).edge_rows) == 0
