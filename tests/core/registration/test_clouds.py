"""Registration of clouds without lines and beams."""

from __future__ import annotations

import cloud_scenes
import numpy as np
import pytest
import synthetic

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import register
from scan3d_twin.core.registration.clouds.patches import NORMAL, POINT, WINDOW, prepare_cloud
from scan3d_twin.core.registration.pose_prior import PLANAR, PosePrior, predict_rmse
from scan3d_twin.core.types import FloatArray, Pose2

WALL = (synthetic.Box((1.0, -5.0, 0.0), (1.5, 5.0, 2.0)),)
FIRST, SECOND = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
MOVE = FIRST.inverse() @ SECOND
OFF = Pose2(0.02, -0.02, 0.02)


def cloud(
    pose: Pose2, boxes: tuple[synthetic.Box, ...], seed: int, sigma: float, stride: int = 1
) -> FloatArray:
    """Return what every ``stride``-th line of a sweep sees of ``boxes``."""
    rng = np.random.default_rng(seed)
    image = synthetic.observe(pose, boxes, room=False, sigma=sigma, rng=rng).image
    points = image.points[::stride].reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        return points[(points[:, 2] > 0.03) & np.isfinite(points[:, 0])]


@pytest.fixture(scope="module")
def boxes() -> tuple[FloatArray, FloatArray]:
    three = synthetic.THREE_BOXES
    return cloud(FIRST, three, 1, 0.005), cloud(SECOND, three, 2, 0.005)


def error(T: FloatArray, points: FloatArray) -> float:
    return error_from(MOVE.matrix(), T, points)


def error_from(truth: FloatArray, T: FloatArray, points: FloatArray) -> float:
    off = np.linalg.inv(truth) @ T
    moved = points @ off[:3, :3].T + off[:3, 3]
    return float(np.sqrt(np.mean(np.sum((moved - points) ** 2, axis=1))))


@pytest.mark.parametrize("dof", ["planar", "se3"])
def test_boxes_are_found_again_and_the_covariance_says_how_well(boxes, dof):
    target, source = boxes
    prior = PosePrior.planar(MOVE @ OFF, 0.02, 0.035)
    result = register(target, source, prior=prior, dof=dof)
    assert result.converged
    assert error(result.T_target_source, source) < 0.004
    assert error(prior.T, source) > 0.02
    assert 0.0001 < result.predicted_rmse < 0.004
    assert result.fitness > 0.5


def test_on_a_bare_wall_the_slide_is_left_to_the_prior_and_reported():
    target, source = (cloud(p, WALL, s, 0.005) for p, s in ((FIRST, 1), (SECOND, 2)))
    prior = PosePrior.planar(MOVE @ OFF, 0.02, 0.035)
    result = register(target, source, prior=prior)
    along = FIRST.inverse().rotate(np.array([0.0, 1.0]))
    slide = (result.T_target_source[:2, 3] - MOVE.matrix()[:2, 3]) @ along
    offset = (prior.T[:2, 3] - MOVE.matrix()[:2, 3]) @ along
    assert slide == pytest.approx(offset, abs=0.004)
    assert len(result.degenerate_directions) == 1
    assert result.predicted_rmse == pytest.approx(0.02, rel=0.3)


def test_without_a_prior_an_init_will_do(boxes):
    target, source = boxes
    result = register(target, source, init_T_target_source=MOVE @ OFF)
    assert error(result.T_target_source, source) < 0.004
    planar = result.covariance[np.ix_(PLANAR, PLANAR)]
    assert np.all(np.linalg.eigvalsh(planar) > 0)
    assert predict_rmse(source, result.covariance) < 0.01


def test_bad_clouds_are_refused(boxes):
    target, source = boxes
    with pytest.raises(ConfigError, match=r"shape \(n, 3\)"):
        register(target[:, :2], source)
    with pytest.raises(RegistrationError, match="0 finite points"):
        register(np.full((100, 3), np.nan), source)
    with pytest.raises(RegistrationError, match="no overlap"):
        register(target, source + np.array([50.0, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="finite"):
        register(target, source, init_T_target_source=np.full((4, 4), np.nan))
    with pytest.raises(ConfigError, match="dof"):
        register(target, source, dof="all")
    image = synthetic.observe(FIRST, synthetic.THREE_BOXES, room=False).image
    with pytest.raises(ConfigError, match="a sweep and a cloud"):
        register(image, source)
    with pytest.raises(ConfigError, match="starts"):
        register(target, source, starts=0)


def test_clouds_without_a_surface_or_a_common_size_are_refused(boxes):
    rng = np.random.default_rng(0)
    for strange in (np.ones((100, 3)), np.linspace(0.0, 1.0, 200)[:, None] * np.ones(3)):
        with pytest.raises(RegistrationError, match="no overlap"):
            register(strange, strange)
    with pytest.raises(RegistrationError, match="no resolution in common"):
        register(rng.normal(size=(60, 3)) * 0.01, rng.normal(size=(20000, 3)) * (50.0, 50.0, 1.0))


def test_windows_hold_enough_points_where_lines_lie_far_apart():
    """Lines 1.5 deg apart, beams 0.35 deg: in windows of few points errors of normals decide.

    With half as many points in a window the median error is twice as large.
    """
    errors = []
    for seed in range(3):
        target, source = (
            cloud(pose, synthetic.THREE_BOXES, 2 * seed + k, 0.003, stride=3)
            for k, pose in enumerate((FIRST, SECOND))
        )
        result = register(target, source, init_T_target_source=MOVE @ OFF)
        errors.append(error(result.T_target_source, source))
        assert result.converged
    assert np.median(errors) < 0.00035
    windows = prepare_cloud(target).levels[0].flat_patches[:, WINDOW]
    assert np.median(windows) > 20


@pytest.mark.parametrize("dof", ["planar", "se3"])
def test_points_without_noise_are_laid_on_each_other_exactly(dof):
    rng = np.random.default_rng(0)
    clouds = []
    for _ in range(2):
        points, axis = rng.uniform(-1, 1, (8000, 3)), rng.integers(3, size=8000)
        points[np.arange(8000), axis] = rng.choice([-1.0, 1.0], 8000)
        clouds.append(points * (1.0, 1.5, 2.0))
    result = register(clouds[0], clouds[1] + (0.1, 0.0, 0.0), dof=dof)
    assert result.converged
    assert result.T_target_source[:3, 3] == pytest.approx([-0.1, 0.0, 0.0], abs=1e-5)
    assert result.predicted_rmse < 1e-5


def test_patches_face_the_viewpoint(boxes):
    for level in prepare_cloud(boxes[0]).levels:
        patches = level.flat_patches
        assert np.all(np.sum(patches[:, NORMAL] * patches[:, POINT], axis=1) <= 0)
        assert np.linalg.norm(patches[:, NORMAL], axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("angle", [0.0, 1.6, 3.1, 4.7])
def test_a_guess_far_off_is_as_good_as_a_near_one(boxes, angle):
    target, source = boxes
    near = register(target, source, init_T_target_source=MOVE)
    far = Pose2(0.25 * np.cos(angle), 0.25 * np.sin(angle), 0.14)
    result = register(target, source, init_T_target_source=MOVE @ far)
    assert result.converged
    assert error(result.T_target_source, source) < 0.004
    assert result.T_target_source == pytest.approx(near.T_target_source, abs=2e-4)


@pytest.mark.parametrize("seed", range(20000, 20012))
def test_rooms_and_objects_are_found_from_far_off_by_any_sensor(seed):
    pair = cloud_scenes.random_pair(seed)
    result = register(pair.target, pair.source, init_T_target_source=pair.init, dof=pair.dof)
    off = cloud_scenes.point_error(pair.source, result.T_target_source, pair.truth)
    assert result.converged
    assert off < 0.005
    assert off < max(3 * result.predicted_rmse, 0.001)


def test_the_order_of_points_does_not_matter(boxes):
    target, source = boxes
    rng = np.random.default_rng(0)
    mixed = register(rng.permutation(target), rng.permutation(source), init_T_target_source=MOVE)
    sorted_ = register(target, source, init_T_target_source=MOVE)
    assert mixed.T_target_source == pytest.approx(sorted_.T_target_source, abs=5e-4)


def test_the_unit_of_length_does_not_matter(boxes):
    """A scene of twice the size gives twice the translation: sides of cells double exactly."""
    target, source = boxes
    one = register(target, source, init_T_target_source=MOVE @ OFF)
    far = (MOVE @ OFF).matrix()
    far[:3, 3] *= 2.0
    two = register(2 * target, 2 * source, init_T_target_source=far)
    assert two.T_target_source[:3, 3] == pytest.approx(2 * one.T_target_source[:3, 3], abs=4e-4)


def test_the_wrong_period_of_a_wave_is_left(boxes):
    """The ends of a wavy front tell its periods of 83 mm apart."""
    rng = np.random.default_rng(3)
    clouds = []
    for _ in range(2):
        y, z = rng.uniform(-0.2, 0.2, 6000), rng.uniform(-0.2, 0.2, 6000)
        x = 0.6 + 0.02 * np.sin(np.pi * 2 * y / 0.083) + 0.003 * rng.standard_normal(6000)
        clouds.append(np.stack([x, y, z], axis=1))
    result = register(*clouds, init_T_target_source=Pose2(0.0, 0.083, 0.0))
    assert error_from(np.eye(4), result.T_target_source, clouds[1]) < 0.002 or not result.converged
