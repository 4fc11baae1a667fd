"""Surfels against surfaces known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import cloud_scenes
import degenerate_pairs
import numpy as np
import pytest
import synthetic

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.surfels.extraction import NORMAL_VARIANCE, N, X
from scan3d_twin.core.registration.surfels.grid import (
    MAX_NOISE_RATIO,
    extract_pair,
    extract_surfels,
)
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise, estimate_noise
from scan3d_twin.core.types import VALID, Pose2, RangeImage, read_only

WALL = (synthetic.Box((1.0, -3.0, 0.0), (1.5, 3.0, 2.0)),)


def wall(sigma: float, seed: int = 0) -> RangeImage:
    rng = np.random.default_rng(seed)
    return synthetic.observe(Pose2(), WALL, room=False, sigma=sigma, rng=rng).image


def upright(image: RangeImage) -> np.ndarray:
    """Return which readings show the wall and not the floor."""
    return np.asarray(image.points[..., 2] > 0.05)


def test_surfels_of_a_noise_free_wall_lie_on_it() -> None:
    image = wall(0.0)
    grid = extract_surfels(image, keep=upright(image), noise=ScanNoise(0.004))
    rows = grid.rows
    deep = rows[(rows[:, 2] > 0.1) & (rows[:, 2] < 1.9)]
    assert np.abs(deep[:, 0] - 1.0).max() < 1e-9
    assert np.abs(deep[:, N] - [-1.0, 0.0, 0.0]).max() < 1e-7


def test_normals_have_no_bias_and_the_stated_variance() -> None:
    """A plane fitted to the points would lean towards the rays by several degrees here."""
    image = wall(0.010)
    grid = extract_surfels(image, keep=upright(image), noise=ScanNoise(0.010))
    rows = grid.rows[grid.index[10:35][grid.index[10:35] >= 0]]  # incidence 12 to 25 deg
    rows = rows[(rows[:, 2] > 0.2) & (rows[:, 2] < 1.0)]
    lean = rows[:, 4]
    assert abs(lean.mean()) < 0.012
    assert lean.std() == pytest.approx(np.sqrt(rows[:, NORMAL_VARIANCE].mean()), rel=0.3)


@pytest.mark.parametrize(
    "body",
    [
        *cloud_scenes.DEGENERATE["cylinder"].bodies,
        *cloud_scenes.DEGENERATE["sphere"].bodies,
        cloud_scenes.Body("sphere", (1.0, 0.0, 0.3), (0.15, 0.15, 0.15)),
    ],
)
def test_surfels_lie_on_round_bodies(body: cloud_scenes.Body) -> None:
    """Planes of windows lie inside, by 1.06, 1.28 and 1.19 mm on average; noise hides half."""
    known, off = ScanNoise(degenerate_pairs.SIGMA, 0.0), []
    axes = 2 if body.kind == "cylinder" else 3
    for seed in range(4):
        sweep = degenerate_pairs.sweep((body,), Pose2(), 2.6, np.random.default_rng(seed))
        points = extract_surfels(sweep, noise=known).rows[:, X]
        away = np.linalg.norm((points - body.centre)[:, :axes], axis=1)
        off.append(np.mean(away - body.size[0]))
    assert abs(np.mean(off)) < 0.0007


def test_normals_vary_more_across_the_ray_than_along_it() -> None:
    """By 2 / (1 + b^2) and 2 b^2 / (1 + b^2) of the stated mean, at an incidence of cosine b."""
    rng, floor = np.random.default_rng(0), cloud_scenes.DEGENERATE["floor"].bodies
    sweeps = [degenerate_pairs.sweep(floor, Pose2(), 2.6, rng) for _ in range(4)]
    known = ScanNoise(degenerate_pairs.SIGMA, 0.0)
    rows = np.concatenate([extract_surfels(sweep, noise=known).rows for sweep in sweeps])
    ray = rows[:, X] - degenerate_pairs.MOUNT[:3, 3]
    b = -ray[:, 2] / np.linalg.norm(ray, axis=1)
    trace = ray[:, :2] / np.linalg.norm(ray[:, :2], axis=1)[:, None]
    along = np.sum(rows[:, 3:5] * trace, axis=1)
    across = rows[:, 4] * trace[:, 0] - rows[:, 3] * trace[:, 1]
    for low, high in ((0.1, 0.2), (0.2, 0.4), (0.4, 0.8)):
        part = (b > low) & (b < high)
        mean, own = rows[part, NORMAL_VARIANCE], b[part] ** 2
        by_across, by_along = np.mean(2 / (1 + own)), np.mean(2 * own / (1 + own))
        assert np.mean(across[part] ** 2 / mean) == pytest.approx(by_across, rel=0.2)
        assert np.mean(along[part] ** 2 / mean) == pytest.approx(by_along, rel=0.5)


def test_smoothing_leaves_a_fraction_of_the_noise() -> None:
    image = wall(0.010)
    rows = extract_surfels(image, keep=upright(image), noise=ScanNoise(0.010)).rows
    assert np.std(rows[:, 0]) < 0.004


@pytest.mark.parametrize("sigma", [0.003, 0.010])
def test_range_noise_is_estimated_from_the_scan(sigma: float) -> None:
    image = wall(sigma)
    found = estimate_noise(image, np.isfinite(image.ranges))
    assert found.range_sigma + found.range_sigma_per_metre == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("jitter", [0.0, 0.002])
def test_yaw_jitter_is_estimated_where_surfaces_are_seen_flat_enough(jitter: float) -> None:
    rng = np.random.default_rng(3)
    image = synthetic.observe(
        Pose2(0.0, 0.0, -0.9), WALL, room=False, sigma=0.003, rng=rng, width=0.6
    ).image
    errors = jitter * rng.standard_normal(image.n_lines)
    shaken = replace(image, yaws=read_only(image.yaws + errors[:, None]))
    found = extract_surfels(shaken).noise.yaw_sigma
    assert found == pytest.approx(jitter, abs=0.0007)


@pytest.mark.parametrize(("first", "last"), [(60.0, -20.0), (20.0, -60.0)])
def test_yaws_of_a_sweep_that_goes_on_to_one_side_count_from_heading_zero(
    first: float, last: float
) -> None:
    image = synthetic.observe(Pose2(), width=math.radians(120.0)).image
    front = np.degrees(image.yaws[:, image.spec.n_beams // 2])
    kept = (front <= first) & (front >= last)
    image = replace(
        image, stamps=image.stamps[kept], yaws=image.yaws[kept], ranges=image.ranges[kept],
        codes=image.codes[kept],
    )  # fmt: skip
    grid = extract_surfels(image)
    found = grid.index >= 0
    assert np.allclose(grid.yaws[grid.index[found]], image.yaws[found], atol=math.radians(0.5))


def test_points_project_back_to_the_reading_they_came_from() -> None:
    image = synthetic.observe(Pose2(), width=2.0).image
    tilted = np.array(image.T_base_lidar)
    a = 0.05
    tilted[:3, :3] = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    tilted[:3, :3] = tilted[:3, :3] @ [
        [1, 0, 0],
        [0, np.cos(a), -np.sin(a)],
        [0, np.sin(a), np.cos(a)],
    ]
    tilted[1, 3] = 0.02
    for mount in (image.T_base_lidar, tilted):
        mounted = replace(image, T_base_lidar=read_only(mount))
        grid = extract_surfels(mounted)
        seen = np.isfinite(mounted.ranges).reshape(-1)
        points = mounted.points.reshape(-1, 3)
        far = seen & (np.hypot(points[:, 0], points[:, 1]) > 0.3)
        ahead = np.abs(np.tile(mounted.spec.elevations, mounted.n_lines)) < 1.4
        index = np.flatnonzero(far & ahead)
        found = grid.projection.lookup(points[index], np.ones(len(points), dtype=bool))
        assert np.mean(found == index) > 0.99


def test_bad_images_are_refused() -> None:
    image = wall(0.004)
    nothing = replace(
        image,
        ranges=read_only(np.full_like(image.ranges, np.nan)),
        codes=read_only(np.zeros_like(image.codes), np.int64),
    )
    with pytest.raises(RegistrationError, match="too little surface"):
        extract_surfels(nothing)
    with pytest.raises(RegistrationError, match="too small"):
        extract_surfels(replace(image, stamps=image.stamps[:3], yaws=image.yaws[:3],
                        ranges=image.ranges[:3], codes=image.codes[:3]))  # fmt: skip
    with pytest.raises(ConfigError, match="ranges has shape"):
        extract_surfels(replace(image, ranges=image.ranges[:, :100]))
    with pytest.raises(ConfigError, match="finite"):
        extract_surfels(replace(image, yaws=read_only(image.yaws * np.nan)))
    with pytest.raises(ConfigError, match="keep has shape"):
        extract_surfels(image, keep=np.ones((2, 2), dtype=bool))
    with pytest.raises(ConfigError, match="range_sigma"):
        ScanNoise(range_sigma=float("nan"))


def test_filled_gaps_are_no_readings() -> None:
    image = wall(0.004)
    codes = np.array(image.codes)
    codes[:, 300:340] = 0
    grid = extract_surfels(replace(image, codes=read_only(codes, np.int64)))
    assert (grid.index[:, 300:340] < 0).all()
    assert not grid.at(np.s_[:, 300:340]).any()
    assert VALID not in codes[:, 300:340]


@pytest.mark.parametrize("order", [1, -1], ids=["target has more", "source has more"])
@pytest.mark.parametrize(
    ("ratio", "kept"), [(1.2, False), (1.01 * MAX_NOISE_RATIO, True)], ids=["one", "two lidars"]
)
def test_two_sweeps_share_the_larger_noise_unless_they_are_of_two_lidars(
    order: int, ratio: float, kept: bool
) -> None:
    stated = [
        replace(wall(0.004, seed), noise=read_only([sigma, 0.0, 0.001, 1.0]))
        for seed, sigma in enumerate((0.004 * ratio, 0.004))
    ]
    first, second = extract_pair(*stated[::order])
    found = [first.noise.range_sigma, second.noise.range_sigma][::order]
    assert found == pytest.approx([0.004 * ratio, 0.004 if kept else 0.004 * ratio])
