"""Smoothing of range images, whatever the lines look like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from synthetic import Shift, interleaved, irregular

from scan3d_twin.core.scanning.smoothing import smooth
from scan3d_twin.core.types import UNMEASURED, Pose2, RangeImage, read_only

WALL = (synthetic.Box((1.0, -3.0, 0.0), (1.5, 3.0, 3.0)),)


def take(sigma: float, shift: Shift | None) -> RangeImage:
    rng = np.random.default_rng(3)
    return synthetic.observe(
        Pose2(0.0, 0.0, -0.7), WALL, room=False, sigma=sigma, rng=rng, shift=shift, width=0.6
    ).image


def distances(image: RangeImage) -> np.ndarray:
    """Return how far behind the wall its readings are, but for its ends and those near them [m]."""
    points = Pose2(0.0, 0.0, -0.7).apply(image.points)[5:-5]
    within = (points[..., 2] > 0.2) & (points[..., 2] < 1.2)
    return np.asarray(points[within][:, 0] - 1.0)


@pytest.mark.parametrize("shift", [None, interleaved, irregular])
def test_a_plane_stays_where_it_is(shift: Shift | None) -> None:
    assert np.abs(distances(smooth(take(0.0, shift)))).max() < 3e-4
    if shift is not None:  # had the elevations not been told, it would be torn up
        image = take(0.0, shift)
        told = replace(smooth(replace(image, elevations=None)), elevations=image.elevations)
        assert np.abs(distances(told)).max() > 1e-3


@pytest.mark.parametrize("shift", [None, interleaved, irregular])
def test_noise_is_averaged_out(shift: Shift | None) -> None:
    noisy = take(0.010, shift)
    before, after = distances(noisy).std(), distances(smooth(noisy)).std()
    assert after < 0.35 * before


def test_places_without_a_beam_do_not_hinder() -> None:
    image = take(0.010, irregular)
    codes = np.array(image.codes)
    codes[np.random.default_rng(0).random(codes.shape) < 0.05] = UNMEASURED
    ranges = np.where(codes == UNMEASURED, np.nan, image.ranges)
    holed = replace(image, codes=read_only(codes, np.int64), ranges=read_only(ranges))
    smoothed = smooth(holed)
    assert np.array_equal(np.isnan(smoothed.ranges), np.isnan(ranges))
    assert distances(smoothed).std() < 0.35 * distances(holed).std()
