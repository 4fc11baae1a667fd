from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_config, paper_registration
from synthetic import THREE_BOXES, observe

from scan3d_twin.core.registration.icp import (
    find_border,
    fit_planar,
    register,
    select_overlapping_lines,
)
from scan3d_twin.core.scanning.target.extraction import extract_points
from scan3d_twin.core.types import FloatArray, Pose2, Scan3D, rms

CONFIG = paper_registration()
shifts = st.floats(-0.02, 0.02)
turns = st.floats(-0.03, 0.03)


@cache
def boxes_scan(pose: Pose2, seed: int = 0) -> Scan3D:
    observation = observe(pose, room=False, sigma=0.003, rng=np.random.default_rng(seed))
    return extract_points(observation.image, paper_config())


@pytest.fixture(scope="module")
def scan() -> Scan3D:
    return boxes_scan(Pose2(-0.4, 0.1, 0.0))


def wall(n: int = 60, m: int = 30) -> FloatArray:
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, n), np.linspace(0.0, 0.5, m), indexing="ij")
    return np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1)


@given(shifts, shifts, turns)
def test_known_pairs_are_fitted_exactly(x: float, y: float, yaw: float) -> None:
    rng = np.random.default_rng(0)
    source = rng.normal(size=(50, 3))
    pose = Pose2(x, y, yaw)
    fitted = fit_planar(pose.apply(source), source)
    assert (fitted.x, fitted.y, fitted.yaw) == pytest.approx((x, y, yaw), abs=1e-9)


def test_fit_minimises_equation_1(scan: Scan3D) -> None:
    rng = np.random.default_rng(1)
    source = scan.points[::50]
    target = Pose2(0.03, -0.02, 0.05).apply(source) + 0.005 * rng.normal(size=source.shape)
    best = fit_planar(target, source)
    error = rms((best.apply(source) - target)[:, :2])
    for dx, dy, dyaw in ((1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1e-3), (-1e-3, 0, 0), (0, 0, -1e-3)):
        other = Pose2(best.x + dx, best.y + dy, best.yaw + dyaw)
        assert rms((other.apply(source) - target)[:, :2]) > error


@settings(max_examples=15, deadline=None)
@given(shifts, shifts, turns)
def test_small_motions_of_a_featureful_scan_are_recovered(x: float, y: float, yaw: float) -> None:
    target, source = boxes_scan(Pose2(-0.4, 0.1, 0.0), 1), boxes_scan(Pose2(-0.4, 0.1, 0.0), 2)
    motion = Pose2(x, y, yaw)
    result = register(target.points, source.points, init_T_target_source=motion, config=CONFIG)
    found = Pose2.from_matrix(result.T_target_source)
    assert result.converged
    # The lines of both scans are 9 mm apart, and plain ICP locks on to them.
    assert rms(found.apply(source.points) - source.points) < 0.012
    assert result.fitness > 0.95


def test_z_roll_and_pitch_are_left_alone(scan: Scan3D) -> None:
    source = Pose2(0.01, 0.01, 0.02).inverse().apply(scan.points)
    T = register(scan.points, source).T_target_source
    assert np.array_equal(T[2], [0.0, 0.0, 1.0, 0.0])
    assert np.array_equal(T[:2, 2], [0.0, 0.0])


def test_plain_icp_cannot_see_a_slide_along_a_wall() -> None:
    target = wall()
    slid = target + np.array([0.0, 0.03, 0.0])
    rng = np.random.default_rng(0)
    border = np.abs(target[:, 1]) > 0.49
    noisy = slid + 0.004 * rng.normal(size=slid.shape)
    result = register(target, noisy[np.abs(slid[:, 1]) < 0.4], border=border)
    left = Pose2.from_matrix(result.T_target_source).y + 0.03
    assert left > 0.015  # most of the slide stays, and the residual does not show it
    assert result.inlier_rmse < 0.02


def test_pairs_on_the_border_drag_the_scan_back() -> None:
    rng = np.random.default_rng(0)
    target = wall()
    source = wall() + np.array([0.0, 0.1, 0.0]) + 0.004 * rng.normal(size=target.shape)
    border = np.abs(target[:, 1]) > 0.49
    kept = register(target, source, border=border, config=replace(CONFIG, border="keep"))
    dropped = register(target, source, border=border)
    assert Pose2.from_matrix(kept.T_target_source).y < -0.03
    assert abs(Pose2.from_matrix(dropped.T_target_source).y) < 0.5 * abs(
        Pose2.from_matrix(kept.T_target_source).y
    )


@pytest.mark.parametrize("n", [0, 5])
def test_too_few_points_do_not_converge(scan: Scan3D, n: int) -> None:
    guess = Pose2(1.0, 2.0, 0.5)
    for a, b in ((scan.points, scan.points[:n]), (scan.points[:n], scan.points)):
        result = register(a, b, init_T_target_source=guess)
        assert not result.converged
        assert result.fitness == 0.0
        assert np.allclose(result.T_target_source, guess.matrix())


def test_scans_without_overlap_do_not_converge(scan: Scan3D) -> None:
    result = register(scan.points, scan.points + np.array([5.0, 0.0, 0.0]))
    assert not result.converged


def test_iterations_that_run_out_are_reported(scan: Scan3D) -> None:
    source = Pose2(0.03, 0.02, 0.03).apply(scan.points)
    result = register(scan.points, source, config=replace(CONFIG, max_iterations=2))
    assert result.iterations == 2
    assert not result.converged


def test_covariance_inverts_information_on_the_plane(scan: Scan3D) -> None:
    result = register(scan.points, Pose2(0.01, 0.0, 0.01).apply(scan.points))
    plane = np.ix_([0, 1, 5], [0, 1, 5])
    product = result.covariance[plane] @ result.information[plane]
    assert np.allclose(product, np.eye(3), atol=1e-6)
    assert not result.information[2:5].any()
    assert result.predicted_rmse > 0


def test_only_lines_on_the_shared_surface_overlap() -> None:
    target = boxes_scan(Pose2(-0.4, 0.6, 0.0))
    pose = Pose2(-0.4, 0.1, 0.0)
    source = boxes_scan(pose)
    init = Pose2(0.0, -0.5, 0.0)
    overlap = select_overlapping_lines(target, source, init)
    y = init.apply(overlap.points)[:, 1]
    assert 0 < len(overlap) < len(source)
    assert y.min() > target.points[:, 1].min() - 0.05
    assert len(select_overlapping_lines(target, source.select(source.lines < 0), init)) == 0


def test_cut_lines_are_the_first_and_the_last() -> None:
    lines = np.array([2, 2, 5, 9])
    scan = Scan3D(np.zeros((4, 3)), lines, lines, 12)
    assert list(find_border(scan, right=True)) == [True, True, False, True]
    assert list(find_border(scan, right=False)) == [True, True, False, False]


def test_same_input_same_result(scan: Scan3D) -> None:
    source = Pose2(0.01, 0.01, math.radians(1)).apply(scan.points)
    a, b = register(scan.points, source), register(scan.points, source)
    assert np.array_equal(a.T_target_source, b.T_target_source)
    assert a.inlier_rmse == b.inlier_rmse


def test_open3d_agrees(scan: Scan3D) -> None:
    open3d = pytest.importorskip("open3d")
    source = Pose2(0.01, -0.01, 0.01).apply(boxes_scan(Pose2(-0.4, 0.1, 0.0), 5).points)[::5]
    clouds = [
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        for points in (source, scan.points)
    ]
    theirs = open3d.pipelines.registration.registration_icp(*clouds, 0.10)
    ours = register(scan.points, source)
    assert ours.fitness == pytest.approx(theirs.fitness, abs=0.02)
    assert np.allclose(ours.T_target_source, theirs.transformation, atol=0.005)


def test_three_boxes_are_what_the_scan_shows(scan: Scan3D) -> None:
    fronts = [box.low[0] + 0.4 for box in THREE_BOXES]
    assert scan.points[:, 0].min() == pytest.approx(min(fronts), abs=0.02)
