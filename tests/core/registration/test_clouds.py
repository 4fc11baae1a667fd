"""Registration of clouds without lines and beams."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import register
from scan3d_twin.core.registration.clouds import prepare_cloud
from scan3d_twin.core.registration.pose_prior import PLANAR, PosePrior, predict_rmse
from scan3d_twin.core.types import FloatArray, Pose2

WALL = (synthetic.Box((1.0, -5.0, 0.0), (1.5, 5.0, 2.0)),)
FIRST, SECOND = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
MOVE = FIRST.inverse() @ SECOND
OFF = Pose2(0.02, -0.02, 0.02)


def cloud(pose: Pose2, boxes: tuple[synthetic.Box, ...], seed: int, sigma: float) -> FloatArray:
    rng = np.random.default_rng(seed)
    image = synthetic.observe(pose, boxes, room=False, sigma=sigma, rng=rng).image
    points = image.points.reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        return points[(points[:, 2] > 0.03) & np.isfinite(points[:, 0])]


@pytest.fixture(scope="module")
def boxes() -> tuple[FloatArray, FloatArray]:
    three = synthetic.THREE_BOXES
    return cloud(FIRST, three, 1, 0.005), cloud(SECOND, three, 2, 0.005)


def error(T: FloatArray, points: FloatArray) -> float:
    off = np.linalg.inv(MOVE.matrix()) @ T
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
        register(target, source, starts=4)


def test_planes_face_the_viewpoint(boxes):
    prepared = prepare_cloud(boxes[0])
    assert np.all(np.sum(prepared.normals * prepared.points, axis=1) <= 0)
    assert np.linalg.norm(prepared.normals, axis=1) == pytest.approx(1.0)
