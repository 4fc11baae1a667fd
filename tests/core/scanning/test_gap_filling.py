from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import observe

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.scanning.gap_filling import fill_gaps
from scan3d_twin.core.types import Pose2, RangeImage, read_only

CONFIG = GapConfig()
BEAM = math.tau / 1024


@pytest.fixture(scope="module")
def image() -> RangeImage:
    """Return a range image of three boxes."""
    return observe(Pose2(-0.4, 0.0, 0.0), room=False).image


def with_ranges(image: RangeImage, ranges: np.ndarray) -> RangeImage:
    """Return ``image`` with other ranges."""
    return replace(image, ranges=read_only(ranges))


def flat(image: RangeImage) -> np.ndarray:
    """Return equal ranges for all readings of ``image``."""
    return np.full(image.ranges.shape, 1.5)


def test_a_narrow_gap_is_interpolated_linearly(image: RangeImage) -> None:
    ranges = flat(image)
    ranges[10, 100:103] = np.nan
    ranges[10, 99], ranges[10, 103] = 1.50, 1.54
    filled = fill_gaps(with_ranges(image, ranges), replace(CONFIG, depth_edge=0.05))
    assert filled.ranges[10, 100:103] == pytest.approx([1.51, 1.52, 1.53])


@pytest.mark.parametrize(("step", "is_filled"), [(40, True), (41, False)])
def test_rounding_does_not_decide_on_a_gap_whose_ends_differ_by_just_the_edge(
    image: RangeImage, step: int, is_filled: bool
) -> None:
    """Readings are whole millimetres: 1.3 m and 40 mm more differ by more than 0.04 in binary."""
    for nearer in range(500, 4000, 70):
        ranges = flat(image)
        ranges[:, 100] = np.nan
        ranges[:, :100], ranges[:, 101:] = nearer / 1000, (nearer + step) / 1000
        filled = fill_gaps(with_ranges(image, ranges), CONFIG)
        assert np.isfinite(filled.ranges[5, 100]) == is_filled, nearer


def test_a_gap_across_a_depth_edge_stays_open_in_both_directions(image: RangeImage) -> None:
    ranges = flat(image)
    ranges[:, 103:] = 1.60
    ranges[:, 100:103] = np.nan
    filled = fill_gaps(with_ranges(image, ranges), CONFIG)
    assert np.isnan(filled.ranges[:, 100:103]).all()


def test_the_widest_gap_that_is_filled(image: RangeImage) -> None:
    beams = math.floor(CONFIG.max_angle / BEAM)  # from valid to valid reading
    ranges = flat(image)
    ranges[:, 100 : 100 + beams - 1] = np.nan
    assert np.isfinite(fill_gaps(with_ranges(image, ranges), CONFIG).ranges).all()
    ranges[:, 100 : 100 + beams] = np.nan
    assert np.isnan(fill_gaps(with_ranges(image, ranges), CONFIG).ranges[:, 100:105]).all()


def test_missing_columns_are_filled_across_lines(image: RangeImage) -> None:
    ranges = flat(image)
    ranges[40:43, :] = np.nan
    filled = fill_gaps(with_ranges(image, ranges), CONFIG)
    assert filled.ranges[40:43] == pytest.approx(np.full((3, ranges.shape[1]), 1.5))


def test_a_gap_at_the_border_stays_open(image: RangeImage) -> None:
    ranges = flat(image)
    ranges[:, :3] = np.nan
    assert np.isnan(fill_gaps(with_ranges(image, ranges), CONFIG).ranges[:, :3]).all()


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_valid_readings_and_codes_never_change(seed: int, share: float) -> None:
    small = observe(Pose2(-0.4, 0.0, 0.0), room=False, width=math.radians(6.0)).image
    holes = np.random.default_rng(seed).random(small.ranges.shape) < share
    ranges = np.where(holes, np.nan, small.ranges)
    filled = fill_gaps(with_ranges(small, ranges), CONFIG)
    kept = np.isfinite(ranges)
    assert np.array_equal(filled.ranges[kept], ranges[kept])
    assert np.array_equal(filled.codes, small.codes)
    new = np.isfinite(filled.ranges) & ~kept
    if new.any():
        assert filled.ranges[new].min() >= np.nanmin(ranges)
        assert filled.ranges[new].max() <= np.nanmax(ranges)
