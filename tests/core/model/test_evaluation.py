from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from paper import paper_config
from scipy.spatial import cKDTree
from synthetic import Box, cast, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.core.model.evaluation import (
    COVERAGE_DISTANCE,
    TRUTH_SPACING,
    Distances,
    Evaluation,
    Reference,
    evaluate_model,
    find_true_pose,
    is_of_target,
    measure_displacement,
)
from scan3d_twin.core.model.fused_cloud import build_model, thin_by_voxel
from scan3d_twin.core.model.sampled_surface import Surface, measure_surface_distance
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Observation, Pose2, read_only

pytestmark = pytest.mark.slow

BOX = Box((0.6, -0.4, 0.0), (1.0, 0.4, 0.6))
SPAWN = Pose2(-0.9, 0.0, 0.0)
FIRST, SECOND = Pose2(-0.4, 0.3, -0.1), Pose2(-0.4, -0.3, 0.1)
"""True poses of two views, in ``map``; ``odom`` is the same frame here."""


@cache
def headings(pose: Pose2) -> FloatArray:
    """Return the headings (n_lines,) of the lines of a sweep [rad]."""
    return observe(pose, (BOX,)).image.yaws[:, 0]


@dataclass(frozen=True)
class BoxTruth:
    """A box in a room, and a robot that was where the stamps of its sweeps say."""

    poses: tuple[Pose2, ...]
    front: Pose2 | None = None
    spawn: Pose2 = SPAWN

    latest = math.inf
    targets = ("target",)

    def pose_at(self, stamp: float) -> Pose2:
        """Sweep k has stamps from 1000 k on; the robot turned, so add the heading of the line."""
        k, line = divmod(stamp, 1000.0)
        yaws = headings(self.poses[int(k)])
        index = min(int(line / 0.1), len(yaws) - 1)
        return self.poses[int(k)] @ Pose2(0.0, 0.0, float(yaws[index]))

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The four sides."""
        points, normals = [], []
        for axis, value, sign in ((0, 0.6, -1), (0, 1.0, 1), (1, -0.4, -1), (1, 0.4, 1)):
            low, high = BOX.low[1 - axis], BOX.high[1 - axis]
            a, z = np.meshgrid(
                np.arange(low, high, spacing) + spacing / 2,
                np.arange(0.0, 0.6, spacing) + spacing / 2,
            )
            side = np.empty((a.size, 3))
            side[:, axis], side[:, 1 - axis], side[:, 2] = value, a.ravel(), z.ravel()
            points.append(side)
            normals.append(np.tile(np.eye(3)[axis] * sign, (len(side), 1)))
        return np.concatenate(points), np.concatenate(normals)

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """The box and the room."""
        return cast(np.asarray(origins), np.asarray(directions), (BOX,), room=True)

    def first_opaque_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Nothing is transparent."""
        return self.first_hits(origins, directions)


def at(pose: Pose2, k: int, sigma: float = 0.0) -> Observation:
    """Return a sweep of the box at ``pose``, stamped for view ``k``."""
    seen = observe(pose, (BOX,), sigma=sigma, rng=np.random.default_rng(k))
    image = replace(seen.image, stamps=seen.image.stamps + 1000.0 * k)
    return Observation(image, pose)


def session_of(*odometry: Pose2, true: tuple[Pose2, ...] = (FIRST, SECOND)) -> Session:
    """Return a session whose views were taken at ``true`` and placed by ``odometry``."""
    hint = np.array([[0.6, 0.0]])
    session = Session(paper_config(tour="full"), 0, hint, np.array([-1.0, 0.0]))
    for k, (measured, pose) in enumerate(zip(odometry, true, strict=False)):
        observation = Observation(at(pose, k).image, measured)
        session = integrate(session, observation)
    return session


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


def test_the_true_pose_is_that_of_all_lines() -> None:
    """The error of a single line, even of the middle one, is not that of the sweep."""
    view = session_of(FIRST).views[0]
    pose = find_true_pose(view, BoxTruth((FIRST,)))
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((FIRST.x, FIRST.y, FIRST.yaw), abs=1e-6)

    # One line that was read 10 mrad off, and all of them
    yaws = view.observation.image.yaws
    middle = int(np.argmin(np.abs(yaws[:, yaws.shape[1] // 2])))
    for lines, least, most in ((middle, -0.0004, 0.0), (np.s_[:], -0.0101, -0.0099)):
        shaken = yaws.copy()
        shaken[lines] += 0.010
        image = replace(view.observation.image, yaws=read_only(shaken))
        moved = replace(view, observation=replace(view.observation, image=image))
        assert least <= find_true_pose(moved, BoxTruth((FIRST,))).yaw - pose.yaw <= most


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


def test_the_truth_is_about_its_own_target_only() -> None:
    session = session_of(FIRST)
    assert is_of_target(session, BoxTruth((FIRST,)))
    other = replace(session, hint=np.array([[0.6, 1.5], [0.6, 1.7]]))
    assert not is_of_target(other, BoxTruth((FIRST,)))


@pytest.mark.parametrize(("share", "scanned"), [(0.05, False), (0.2, True)])
def test_a_target_that_was_asked_for_may_be_a_part_of_what_was_scanned(share, scanned) -> None:
    """A hand is a part of its arm: where the robot takes them for one thing, it scans both."""
    session, count = session_of(FIRST), 100
    inside = np.arange(count) < share * count
    hint = np.where(inside[:, None], session.hint[0], session.hint[0] + (0.0, 3.0))
    mixed = replace(session, hint=hint)
    assert is_of_target(mixed, BoxTruth((FIRST,)), "target") == scanned
    assert not is_of_target(mixed, BoxTruth((FIRST,)))


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


def test_displacement_of_a_turn_grows_with_the_distance() -> None:
    near, far = np.array([[1.0, 0.0, 0.0]]), np.array([[2.0, 0.0, 0.0]])
    turn = Pose2(0.0, 0.0, 0.01)
    assert measure_displacement(near, Pose2(), turn) == pytest.approx(0.01, rel=1e-4)
    assert measure_displacement(far, Pose2(), turn) == pytest.approx(0.02, rel=1e-4)


def test_voxels_are_means() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [0.91, 0.0, 0.0]])
    assert thin_by_voxel(points, 0.1) == pytest.approx(np.array([[0.02, 0.01, 0.01], [0.91, 0, 0]]))
    assert thin_by_voxel(np.zeros((0, 3)), 0.1).shape == (0, 3)


@dataclass(frozen=True)
class TwoBoxes(BoxTruth):
    """The box, and a second one beside it."""

    gap: float = 0.5

    targets = ("near", "beside")

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The four sides of each."""
        points, normals = super().surface(spacing)
        away = np.array([0.0, 0.8 + self.gap, 0.0])
        parts = {"near": points, "beside": points + away}
        chosen = self.targets if targets is None else targets
        return np.concatenate([parts[t] for t in chosen]), np.concatenate([normals] * len(chosen))


def test_the_target_that_was_scanned_counts_and_not_another_one() -> None:
    session = session_of(FIRST, SECOND)
    alone, two = BoxTruth((FIRST, SECOND)), TwoBoxes((FIRST, SECOND))
    model = build_model(session)
    result = evaluate_model(session, model, Reference.of(session, two))
    assert result.targets == ("near",)
    assert result.left_out == ("beside",)
    assert result.coverage == evaluate_model(session, model, Reference.of(session, alone)).coverage


def test_the_target_that_was_asked_for_counts_even_if_another_one_was_scanned() -> None:
    session, two = session_of(FIRST, SECOND), TwoBoxes((FIRST, SECOND))
    reference = Reference.of(session, two, "beside")
    result = evaluate_model(session, build_model(session), reference)
    assert result.targets == ("beside",)
    assert result.left_out == ()
    assert result.coverage < 0.05
    assert not result.is_success(math.inf)
    place = Reference.of(session, two, "0.6,0.0")
    assert place.targets == ("near",)
    assert place.left_out == ()


@pytest.mark.parametrize(("gap", "count"), [(0.15, 2), (0.3, 1)])
def test_targets_that_are_one_thing_to_the_robot_count_together(gap: float, count: int) -> None:
    session, two = session_of(FIRST, SECOND), TwoBoxes((FIRST, SECOND), gap=gap)
    for asked in ("", "near", "beside"):
        assert len(Reference.of(session, two, asked).targets) == count


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
