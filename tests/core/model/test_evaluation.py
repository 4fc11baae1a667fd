from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from box_truth import BOX, FIRST, SECOND, BoxTruth, session_of
from paper import paper_config
from scipy.spatial import cKDTree
from synthetic import Box, cast

from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.core.model.evaluation import (
    COVERAGE_DISTANCE,
    TRUTH_SPACING,
    Distances,
    Evaluation,
    Reference,
    evaluate_model,
)
from scan3d_twin.core.model.fused_cloud import build_model, thin_by_voxel
from scan3d_twin.core.model.sampled_surface import Surface, measure_surface_distance
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2

pytestmark = pytest.mark.slow


def evaluated(session: Session) -> Evaluation:
    """Return the measures of ``session`` against the true box."""
    reference = Reference.of(session, BoxTruth((FIRST, SECOND)))
    return evaluate_model(session, build_model(session), reference)


def test_coverage_grows_view_by_view_to_that_of_the_whole_model() -> None:
    session = session_of(FIRST, SECOND)
    result = evaluated(session)
    alone = evaluated(replace(session, views=session.views[:1]))
    assert result.coverage_by_view[0] == alone.coverage
    assert result.coverage_by_view[0] < result.coverage_by_view[1] == result.coverage
    truth = BoxTruth((FIRST, SECOND))
    reference = Reference.of(session, truth)
    points = reference.T_map_world.apply(build_model(session).points)
    surface, normals = truth.surface(TRUTH_SPACING)
    wanted = surface[find_coverable_surface(surface, normals, truth, session.config)]
    assert result.coverage == np.mean(cKDTree(points).query(wanted)[0] <= COVERAGE_DISTANCE)


def test_a_perfect_run_is_accurate_and_covers_what_it_saw() -> None:
    session = session_of(FIRST, SECOND)
    exact = tuple(
        replace(view, T_world_scan=pose)
        for view, pose in zip(session.views, (FIRST, SECOND), strict=True)
    )
    result = evaluated(replace(session, views=exact))
    assert result.accuracy.p95 < 0.002
    assert result.pairs[0].error == pytest.approx(0.0, abs=1e-9)
    assert result.pairs[0].odometry_error == pytest.approx(0.0, abs=1e-9)
    front = 0.8 / (2 * 0.8 + 2 * 0.4)
    assert result.coverable_share > 0.95
    assert result.coverage == pytest.approx(front, abs=0.06)
    assert result.f_score[0.020] == pytest.approx(2 * front / (1 + front), abs=0.06)


def test_the_error_of_a_pair_is_that_of_its_relative_pose() -> None:
    session = session_of(FIRST, SECOND)
    first, second = session.views
    off = replace(second, T_world_scan=SECOND @ Pose2(-0.02, 0.0, 0.0))
    result = evaluated(replace(session, views=(replace(first, T_world_scan=FIRST), off)))
    assert result.pairs[0].error == pytest.approx(0.02, abs=1e-6)
    assert result.pairs[0].pose_error == pytest.approx(0.02, abs=1e-6)
    assert result.pairs[0].odometry_error == pytest.approx(0.0, abs=1e-9)
    assert result.accuracy.mean > 0.005


def test_the_first_pose_is_the_gauge() -> None:
    shift = Pose2(0.3, -0.2, 0.4)
    session = session_of(FIRST, SECOND)
    placed = zip(session.views, (FIRST, SECOND), strict=True)
    moved = tuple(replace(view, T_world_scan=shift @ pose) for view, pose in placed)
    result = evaluated(replace(session, views=moved))
    assert result.accuracy.p95 < 0.002
    assert result.pairs[0].pose_error == pytest.approx(0.0, abs=1e-9)


def test_only_the_front_is_coverable_on_a_tour_of_the_front() -> None:
    truth = BoxTruth((FIRST,), front=Pose2(0.6, 0.0, math.pi))
    surface, normals = truth.surface(0.02)
    all_round = find_coverable_surface(surface, normals, truth, paper_config(tour="full"))
    front = find_coverable_surface(surface, normals, truth, paper_config(tour="front"))
    back = normals[:, 0] > 0.5
    assert all_round[back].mean() > 0.9
    assert not front[back].any()
    assert front[normals[:, 0] < -0.5].mean() > 0.95
    assert front[np.abs(normals[:, 1]) > 0.5].mean() > 0.9  # seen from beside, still in front


def test_what_stands_too_close_to_a_wall_is_not_coverable() -> None:
    against = BoxTruth((FIRST,))
    surface, normals = against.surface(0.02)
    buried = surface + np.array([1.45, 0.0, 0.0])  # 5 cm in front of the wall at x = 2.5
    seen = find_coverable_surface(buried, normals, _Against(), paper_config(tour="full"))
    assert not seen[normals[:, 0] > 0.5].any()
    assert seen[normals[:, 0] < -0.5].mean() > 0.9


class _Against(BoxTruth):
    """The box 5 cm in front of the wall."""

    def __init__(self) -> None:
        super().__init__((FIRST,))

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """The box where it stands now, and the room."""
        moved = Box((2.05, -0.4, 0.0), (2.45, 0.4, 0.6))
        return cast(np.asarray(origins), np.asarray(directions), (moved,), room=True)


def test_distance_to_a_sampled_plane_has_no_share_of_the_sampling() -> None:
    y, z = np.meshgrid(np.arange(0, 1, 0.02), np.arange(0, 1, 0.02))
    surface = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    normals = np.tile([1.0, 0.0, 0.0], (len(surface), 1))
    points = np.array([[0.003, 0.507, 0.313], [0.0, 0.5, 1.2]])
    distance = measure_surface_distance(points, surface, normals, 0.02)
    assert distance[0] == pytest.approx(0.003)
    assert distance[1] == pytest.approx(1.2 - 0.98 - 0.02 / math.sqrt(2), abs=1e-6)


def test_within_tells_what_distances_would() -> None:
    rng = np.random.default_rng(0)
    surface = Surface.of(rng.uniform(0, 1, (400, 3)), np.tile([0.0, 0.0, 1.0], (400, 1)), 0.02)
    points = rng.uniform(-0.2, 1.2, (500, 3))
    for distance in (0.0, 0.02, 0.1):
        wanted = surface.distance(points) <= distance
        assert np.array_equal(surface.within(points, distance), wanted)
    assert wanted.any()
    assert not wanted.all()


def test_what_nobody_can_see_is_not_covered() -> None:
    session = session_of(FIRST, SECOND)
    session = replace(session, config=replace(session.config, tour="front"))
    out_of_reach = replace(BoxTruth((FIRST, SECOND)), front=Pose2(100.0, 0.0, 0.0))
    result = evaluate_model(session, build_model(session), Reference.of(session, out_of_reach))
    assert result.coverable_share == 0.0
    assert result.coverage == 0.0
    assert result.coverage_by_view == (0.0, 0.0)
    assert set(result.f_score.values()) == {0.0}
    assert not result.is_success(1.0)


def test_statistics() -> None:
    of = Distances.of(np.arange(101) / 100)
    assert (of.mean, of.median, of.p95) == pytest.approx((0.5, 0.5, 0.95))


def test_voxels_are_means() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [0.91, 0.0, 0.0]])
    assert thin_by_voxel(points, 0.1) == pytest.approx(np.array([[0.02, 0.01, 0.01], [0.91, 0, 0]]))
    assert thin_by_voxel(np.zeros((0, 3)), 0.1).shape == (0, 3)


def test_a_model_of_much_else_is_no_success_however_well_it_is_registered() -> None:
    result = evaluated(session_of(FIRST, SECOND))
    assert result.is_success(0.010)
    assert not result.is_success(0.0)
    assert not replace(result, f_score={0.020: 0.29}).is_success(0.010)
    assert not replace(result, pairs=()).is_success(0.010)


@pytest.mark.parametrize("x", [-5.5, 6.9])
def test_a_start_far_from_the_target_counts_as_a_place(x: float) -> None:
    """Beyond the range of the lidar from the target, on either side."""
    truth = _OpenFloor((FIRST,), spawn=Pose2(x, 0.0, 0.0))
    surface, normals = truth.surface(0.02)
    config = paper_config(tour="full")
    assert find_coverable_surface(surface, normals, truth, config).mean() > 0.95


class _OpenFloor(BoxTruth):
    """The box without a room."""

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """The box and the floor."""
        return cast(np.asarray(origins), np.asarray(directions), (BOX,), room=False)
