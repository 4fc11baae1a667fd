"""The last step with the errors that readings share, on sweeps whose errors are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import reference.shared_errors
import synthetic

from scan3d_twin.core.registration.gauss_newton import Criteria, Problem, align
from scan3d_twin.core.registration.multistart import register_grids
from scan3d_twin.core.registration.pose_prior import (
    PLANAR,
    PosePrior,
    displace,
    shift_to_target,
)
from scan3d_twin.core.registration.surfels.extraction import N, X
from scan3d_twin.core.registration.surfels.grid import SurfelGrid, extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage, read_only

SIGMA = 0.004
PATCH, CYCLIC, OFFSET = 0.003, 0.004, 0.003
CYCLE = 1.6
"""Wavelength of the cyclic error [m]: half that of a modulation of 93 MHz."""
ALONE = ScanNoise(SIGMA, bias_sigma=PATCH)
MODEL = replace(ALONE, linearity_sigma=CYCLIC, offset_sigma=OFFSET)
FIRST, SECOND = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
WALL = (synthetic.Box((1.0, -5.0, 0.0), (1.5, 5.0, 2.0)),)
AHEAD, UP = 0.05, 0.30
"""Place of the lidar of ``synthetic`` [m]."""


def spoil(image: RangeImage, error: FloatArray) -> RangeImage:
    return replace(image, ranges=read_only(image.ranges + error))


def patch_errors(image: RangeImage, sigma: float, rng: np.random.Generator) -> FloatArray:
    """Return a range error of each patch of directions, with slopes (n_lines, n_beams) [m]."""
    points = image.points.reshape(-1, 3)
    seen = np.isfinite(points).all(axis=1)
    directions = reference.shared_errors.rays(points[seen], AHEAD, UP)[1]
    patch, along, upwards = reference.shared_errors.places(directions)
    mean, *slopes = sigma * rng.standard_normal((3, 24 * 12))
    found = np.zeros(len(points))
    found[seen] = mean[patch] + slopes[0][patch] * along + slopes[1][patch] * upwards
    return found.reshape(image.ranges.shape)


def grid(image: RangeImage, noise: ScanNoise) -> SurfelGrid:
    with np.errstate(invalid="ignore"):
        keep = (image.points[..., 2] > 0.03) & (image.ranges < 4.0)
    return extract_surfels(image, keep=keep, noise=noise)


def sweeps(seed: int, patch: float) -> tuple[RangeImage, RangeImage, Pose2]:
    """Target and source with the errors of one lidar, and the true pose.

    Offset and cycle are those of the lidar, errors of patches with the sigma ``patch`` [m] those of
    the pair.
    """
    rng = np.random.default_rng([16, seed])
    x, y, yaw = rng.normal(0.0, 0.05, 3)
    second = Pose2(SECOND.x + x, SECOND.y + y, SECOND.yaw + yaw)
    offset, phase = OFFSET * rng.standard_normal(), rng.uniform(0.0, math.tau)
    target, source = (
        synthetic.observe(pose, sigma=SIGMA, rng=rng).image for pose in (FIRST, second)
    )
    target, source = (
        spoil(image, offset + CYCLIC * np.sin(math.tau / CYCLE * image.ranges + phase))
        for image in (target, source)
    )
    return target, spoil(source, patch_errors(source, patch, rng)), FIRST.inverse() @ second


def register(
    pair: tuple[RangeImage, RangeImage, Pose2], noise: ScanNoise
) -> tuple[float, float, float]:
    """Return error [m], predicted error [m] and e^T C^-1 e of a registration."""
    target, source = (grid(image, noise) for image in pair[:2])
    truth = pair[2]
    result = register_grids(target, source, prior=PosePrior.planar(truth, 0.02, 0.035))
    found = Pose2.from_matrix(result.T_target_source)
    off, points = found @ truth.inverse(), source.sample(4).rows[:, :3]
    e, C = np.array([off.x, off.y, off.yaw]), result.covariance[np.ix_(PLANAR, PLANAR)]
    error = math.sqrt(np.mean(np.sum((found.apply(points) - truth.apply(points)) ** 2, axis=1)))
    return error, result.predicted_rmse, float(e @ np.linalg.solve(C, e))


def test_errors_of_the_lidar_are_estimated_and_the_covariance_is_honest() -> None:
    """Median of e^T C^-1 e of a correct covariance: 2.37; with the patches alone it is tenfold.

    The patches' errors are half the assumed ones.
    """
    alone, model = [], []
    for seed in range(1000, 1040):
        pair = sweeps(seed, PATCH / 2)
        alone.append(register(pair, ALONE))
        model.append(register(pair, MODEL))
    (error_alone, _, nees_alone), (error, _, nees) = np.median([alone, model], axis=1)
    assert error < 0.85 * error_alone
    assert nees_alone > 10.0
    assert 1.2 < nees < 3.5


def blur(grid: SurfelGrid, sigma: float, rng: np.random.Generator) -> SurfelGrid:
    """Return the surfels of ``WALL`` with exact normals, off it by noise along their rays alone."""
    rows = grid.rows.copy()
    rays = reference.shared_errors.rays(rows[:, X], AHEAD, UP)[1]
    along = (WALL[0].low[0] - rows[:, 0]) / rays[:, 0] + sigma * rng.standard_normal(len(rows))
    rows[:, X] += along[:, None] * rays
    rows[:, N] = -1.0, 0.0, 0.0
    return replace(grid, rows=read_only(rows))


@pytest.mark.parametrize("yaw_scale_sigma", [0.0, 0.01])
def test_noise_along_the_rays_does_not_turn_a_view(yaw_scale_sigma: float) -> None:
    """It moves a residual, its derivatives and the choice of a partner together.

    A curve of the range error and a yaw scale, which a wall hardly determines, took it up: the view
    was turned by 5 and 6 mrad.
    """
    noise = replace(MODEL, yaw_scale_sigma=yaw_scale_sigma)
    T, yaws = Pose2(0.0, -0.4), []
    images = [
        synthetic.observe(pose, WALL, room=False, sigma=SIGMA, rng=np.random.default_rng(0)).image
        for pose in (Pose2(), T)
    ]
    grids = [grid(image, noise) for image in images]
    for seed in range(1000, 1012):
        rng = np.random.default_rng([18, seed])
        target, source = (blur(each, SIGMA / 3, rng) for each in grids)
        result = register_grids(target, source, prior=PosePrior.planar(T, 0.02, 0.035))
        yaws.append(Pose2.from_matrix(result.T_target_source).yaw)
    assert abs(np.mean(yaws)) < 0.001


def test_errors_larger_than_assumed_widen_the_covariance() -> None:
    predicted = {
        patch: np.median([register(sweeps(seed, patch), MODEL)[1] for seed in range(1000, 1010)])
        for patch in (PATCH / 2, 4 * PATCH)
    }
    assert predicted[4 * PATCH] > 1.3 * predicted[PATCH / 2]


def test_errors_of_patches_smaller_than_assumed_narrow_the_covariance() -> None:
    found = {}
    for patch in (0.0, PATCH):
        pairs = [sweeps(seed, patch) for seed in range(1000, 1010)]
        found[patch] = np.median([register(pair, ALONE)[1] for pair in pairs])
    assert found[0.0] < 0.8 * found[PATCH]


def test_a_nuisance_does_not_take_up_the_error_of_the_prior() -> None:
    """A wall leaves the slide along it to the prior; the yaw scale is what the wall says alone."""
    rng, noise = np.random.default_rng(5), ScanNoise(SIGMA, yaw_scale_sigma=0.02)
    target, source = (
        grid(synthetic.observe(Pose2(0.0, y), WALL, room=False, sigma=SIGMA, rng=rng).image, noise)
        for y in (0.15, -0.15)
    )
    T, one_step = Pose2(0.0, -0.3).matrix(), Criteria(max_iterations=1)

    # A step with a prior that has no error, and with one 20 mm off along the wall
    covariance = PosePrior.planar(Pose2(), 0.02, 0.035).covariance
    right = align(Problem(target, source, PosePrior(T, covariance), "planar", one_step), T)
    slide = np.linalg.solve(shift_to_target(right.T), right.degenerate[0])
    wrong = displace(T, 0.02 * slide)
    off = align(Problem(target, source, PosePrior(wrong, covariance), "planar", one_step), T)
    assert abs(off.T[1, 3] - right.T[1, 3]) > 0.015
    assert abs(right.yaw_scale) > 1e-4
    assert off.yaw_scale == pytest.approx(right.yaw_scale, abs=1e-6)


def test_the_curve_of_the_range_error_is_a_priori_smooth() -> None:
    """Neighbouring knots are alike, distant ones share the offset alone, all have their sigma."""
    C = reference.shared_errors.curve_covariance(CYCLIC, OFFSET)
    assert np.sqrt(np.diag(C)) == pytest.approx(math.hypot(CYCLIC, OFFSET), rel=1e-3)
    assert C[0, 1] == pytest.approx(CYCLIC**2 / 1.5 + OFFSET**2)
    assert C[0, 23] == pytest.approx(OFFSET**2, rel=0.01)
    assert np.linalg.eigvalsh(C).min() > 0


def test_the_curve_counts_without_errors_of_patches() -> None:
    """Each kind of shared error works alone: no patch error does not switch off the others."""
    *images, true = sweeps(1, 0.0)
    prior = PosePrior.planar(true, 0.02, 0.035)
    expected = []
    for noise in (ScanNoise(SIGMA), ScanNoise(SIGMA, linearity_sigma=CYCLIC)):
        target, source = (grid(image, noise) for image in images)
        expected.append(register_grids(target, source, prior=prior).predicted_rmse)
    assert expected[1] > 1.2 * expected[0]
