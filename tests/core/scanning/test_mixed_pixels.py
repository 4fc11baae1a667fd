from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from synthetic import observe

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.scanning.mixed_pixels import remove_mixed_pixels
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import MIXED, VALID, Pose2, RangeImage, read_only
from scan3d_twin.sim.robot import open_sim

CONFIG = GapConfig()


@pytest.fixture(scope="module")
def image() -> RangeImage:
    """Return a range image of three boxes."""
    return observe(Pose2(-0.4, 0.0, 0.0), room=False).image


def with_ranges(image: RangeImage, ranges: np.ndarray) -> RangeImage:
    """Return ``image`` with other ranges, NaN for no reading."""
    codes = np.where(np.isfinite(ranges), VALID, 0)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))


def test_what_hangs_between_two_surfaces_is_dropped_along_and_across_lines(image):
    ranges = np.full(image.ranges.shape, 1.0)
    ranges[20:, :] = 1.5
    ranges[20, :] = 1.25  # the silhouette of the nearer surface, a line of mixed pixels
    ranges[:20, 200:] = 2.0
    ranges[:20, 200] = 1.4
    clean = remove_mixed_pixels(with_ranges(image, ranges), CONFIG)
    mixed = np.zeros(ranges.shape, dtype=bool)
    mixed[20, :200] = True  # beyond, the line lies before both of its neighbours
    mixed[:20, 200] = True
    np.testing.assert_array_equal(np.isnan(clean.ranges), mixed)
    assert (clean.codes[mixed] == MIXED).all()
    assert (clean.codes[~mixed] == VALID).all()


@pytest.mark.parametrize("off", [-0.06, 0.06])
@pytest.mark.parametrize("side", [1, -1])
def test_what_hangs_beside_a_silhouette_is_dropped_where_nothing_is_behind(image, off, side):
    wall = 1.0 / np.cos(image.yaws[:, :1])
    ranges = np.array(np.broadcast_to(wall, image.ranges.shape))
    ranges[30::side] = np.nan
    clean = remove_mixed_pixels(with_ranges(image, ranges), CONFIG)
    np.testing.assert_array_equal(np.isnan(clean.ranges), np.isnan(ranges))
    last = 30 - side
    ranges[last, :200] += off
    clean = remove_mixed_pixels(with_ranges(image, ranges), CONFIG)
    ranges[last, :200] = np.nan
    np.testing.assert_array_equal(clean.ranges, ranges)


def test_steep_surfaces_thin_things_and_noise_stay(image):
    yaw = image.yaws[:, :1]
    wall = 1.0 / np.cos(yaw + math.radians(50.0))  # seen at 35 to 75 deg or so
    flat = np.broadcast_to(np.clip(wall, 0.5, 3.9), image.ranges.shape)
    noise = 0.005 * np.random.default_rng(0).standard_normal(flat.shape)
    pole = np.full(flat.shape, 2.0)
    pole[30] = 1.0
    for ranges in (flat + noise, pole):
        clean = remove_mixed_pixels(with_ranges(image, np.array(ranges)), CONFIG)
        assert np.isfinite(clean.ranges).all()


def test_of_a_sweep_by_a_broad_beam_few_readings_are_dropped():
    with open_sim("three_boxes", 5) as (robot, _):
        raw = sweep(robot, 0.0, paper_config(), lambda line: None).image
    clean = remove_mixed_pixels(raw, CONFIG)
    dropped = np.count_nonzero(np.isfinite(raw.ranges) & ~np.isfinite(clean.ranges))
    assert 0 < dropped < 0.01 * np.count_nonzero(np.isfinite(raw.ranges))
