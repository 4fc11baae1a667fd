"""Noise estimated from sweeps whose noise is known: a plane, a box, and a wavy front."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from degenerate_pairs import draw_pair

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise, estimate_noise
from scan3d_twin.core.types import VALID, FloatArray, RangeImage, read_only

SCENES = ("plane", "box", "sine")
STEP = math.radians(0.5)
AHEAD, UP = 0.05, 0.30
"""Place of the lidar [m]."""
BEAMS = 213
"""75 deg: what a robot near the floor sees of an object."""


def outline(scene: str) -> tuple[FloatArray, float]:
    """Return corners in the top view (n, 2) and the half width of a sweep over them [rad]."""
    if scene == "plane":
        return np.array([[1.0, 6.0], [1.0, -6.0]]), math.radians(40.0)
    if scene == "box":  # two faces, 45 deg from the line of sight
        return np.array([[1.6, 0.6], [1.0, 0.0], [1.6, -0.6]]), math.radians(17.0)
    y = np.linspace(0.35, -0.35, 561)  # waves of 83 mm, 20 mm high
    return np.stack([0.6 + 0.02 * np.sin(math.tau * y / 0.083), y], axis=1), math.radians(28.0)


def observe(
    scene: str,
    noise: FloatArray | float = 0.0,
    jitter: float = 0.0,
    uneven: float = 0.0,
    seed: int = 0,
) -> RangeImage:
    """Return a sweep over a scene.

    Args:
        scene: One of ``SCENES``.
        noise: Of each reading (n_lines, BEAMS), or the sigma of independent noise [m].
        jitter: Sigma of the lines' yaws, unknown to the robot [rad].
        uneven: Amplitude of the robot's own uneven turning, which it knows [line spacings].
        seed: Of the noise.
    """
    rng = np.random.default_rng([21, seed])
    corners, half = outline(scene)
    yaws = np.arange(half, -half, -STEP)
    yaws = yaws + uneven * STEP * rng.uniform(-1.0, 1.0, len(yaws))
    elevations = (np.arange(BEAMS) - BEAMS // 2) * math.tau / 1024
    rho = cast(corners, yaws + jitter * rng.standard_normal(len(yaws)))

    # a front 1 m high
    with np.errstate(invalid="ignore"):
        z = UP + rho[:, None] * np.tan(elevations)
        ranges = np.where((z > 0.03) & (z < 1.0), rho[:, None] / np.cos(elevations), np.nan)
    if isinstance(noise, float):
        noise = noise * rng.standard_normal(ranges.shape)
    ranges = ranges + noise
    return RangeImage(
        read_only(0.1 * np.arange(len(yaws))),
        read_only(np.repeat(yaws[:, None], BEAMS, axis=1)),
        read_only(ranges),
        read_only(np.where(np.isfinite(ranges), VALID, 0), np.int64),
        replace(synthetic.spec(BEAMS), elevations=read_only(elevations)),
        read_only([[1, 0, 0, AHEAD], [0, 1, 0, 0], [0, 0, 1, UP], [0, 0, 0, 1.0]]),
    )


def cast(corners: FloatArray, yaws: FloatArray) -> FloatArray:
    """Return the distance in the top view to the first edge at each yaw (n,); NaN for none."""
    d = np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    a, edge = corners[:-1], np.diff(corners, axis=0)
    to_a = a - AHEAD * d[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        det = d[:, None, 0] * edge[:, 1] - d[:, None, 1] * edge[:, 0]
        rho = (to_a[..., 0] * edge[:, 1] - to_a[..., 1] * edge[:, 0]) / det
        share = (to_a[..., 0] * d[:, None, 1] - to_a[..., 1] * d[:, None, 0]) / det
        hit = (share >= 0) & (share <= 1) & (rho > 0)
    nearest = np.where(hit, rho, np.inf).min(axis=1)
    return np.where(np.isfinite(nearest), nearest, np.nan)


def estimate(image: RangeImage) -> ScanNoise:
    return estimate_noise(image, np.isfinite(image.ranges))


def sigma_of(image: RangeImage) -> float:
    """Return the estimated range sigma in the middle of a sweep's ranges [m]."""
    found = estimate(image)
    return found.range_sigma + found.range_sigma_per_metre * float(np.nanmedian(image.ranges))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("sigma", [0.003, 0.010])
def test_range_noise(scene: str, sigma: float) -> None:
    """Neither the edge of a box nor waves 20 mm high are noise."""
    images = [observe(scene, sigma, seed=seed) for seed in range(8)]
    assert np.mean([sigma_of(image) for image in images]) == pytest.approx(sigma, rel=0.1)
    factor = float(np.mean([estimate(image).correlation for image in images]))
    assert factor == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("width", [2, 3, 4])
def test_correlated_noise(scene: str, width: int) -> None:
    """A mean over ``width`` beams leaves a mean along a line with ``width`` times the variance."""
    shape, factors, sigmas = observe(scene).ranges.shape, [], []
    for seed in range(8):
        white = np.random.default_rng(seed).standard_normal((shape[0], shape[1] + width - 1))
        windows = np.lib.stride_tricks.sliding_window_view(white, width, axis=1)
        image = observe(scene, 0.005 * windows.sum(axis=2) / math.sqrt(width))
        factors.append(estimate(image).correlation)
        sigmas.append(sigma_of(image))
    assert np.mean(factors) == pytest.approx(width, rel=0.2)
    assert np.mean(sigmas) == pytest.approx(0.005, rel=0.1)


def rms_jitter(scene: str, jitter: float, uneven: float = 0.0, sigma: float = 0.003) -> float:
    """Return the estimate [deg] over some sweeps whose lines err by ``jitter`` [deg]."""
    images = [observe(scene, sigma, math.radians(jitter), uneven, seed) for seed in range(100, 112)]
    return math.degrees(math.sqrt(np.mean([estimate(image).yaw_sigma ** 2 for image in images])))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    ("jitter", "sigma"), [(0.05, 0.003), (0.1, 0.003), (0.2, 0.003), (0.2, 0.01)]
)
def test_yaw_jitter(scene: str, jitter: float, sigma: float) -> None:
    """With 10 mm most slopes of a plane are noise, which must not hide the jitter."""
    assert rms_jitter(scene, jitter, sigma=sigma) == pytest.approx(jitter, rel=0.3)


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_lines_that_tell_nothing_leave_what_was_expected(jitter: float) -> None:
    """Slopes of a narrow wall straight ahead are noise: neither no jitter nor its size is shown."""
    found = []
    for seed in range(12):
        image = observe("plane", 0.010, math.radians(jitter), seed=seed)
        middle = slice(image.n_lines // 2 - 24, image.n_lines // 2 + 24)
        lines = (each[middle] for each in (image.stamps, image.yaws, image.ranges, image.codes))
        narrow = RangeImage(*lines, image.spec, image.T_base_lidar)
        found.append(math.degrees(estimate(narrow).yaw_sigma))
    assert np.median(found) == pytest.approx(0.08, abs=0.01)


def test_pillars_before_a_wall_are_no_jitter() -> None:
    """Each ends among the lines of a difference, at all heights alike, as a yaw error would."""
    images = [draw_pair("pillars", seed).target for seed in range(12)]
    found = math.sqrt(np.mean([estimate(image).yaw_sigma ** 2 for image in images]))
    assert math.degrees(found) < 0.05


@pytest.mark.parametrize("scene", SCENES)
def test_steady_lines_have_little_jitter(scene: str) -> None:
    """What is left is not 0: the range noise hides a little."""
    assert 0.0 < rms_jitter(scene, 0.0) < 0.03


@pytest.mark.parametrize(("scene", "limit"), [("plane", 0.03), ("box", 0.03), ("sine", 0.05)])
def test_uneven_lines_of_known_yaw_are_no_jitter(scene: str, limit: float) -> None:
    """The lines are a quarter of a spacing off, 0.07 deg in the RMS."""
    assert rms_jitter(scene, 0.0, uneven=0.25) < limit


@pytest.mark.parametrize("scene", ["plane", "sine"])
def test_uneven_lines_hide_no_more_jitter_than_even_ones(scene: str) -> None:
    """The slopes of the range are mostly noise with 10 mm; that must not pass for a yaw error."""
    even, uneven = (rms_jitter(scene, 0.0, shift, sigma=0.010) for shift in (0.0, 0.25))
    assert uneven < 1.1 * even


def test_known_noise_is_refused_where_it_is_none() -> None:
    with pytest.raises(ConfigError, match="correlation"):
        ScanNoise(correlation=0.5)
    with pytest.raises(ConfigError, match="linearity_sigma"):
        ScanNoise(linearity_sigma=-0.001)
