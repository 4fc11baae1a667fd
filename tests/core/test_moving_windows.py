"""Moving windows against those of SciPy, which a run does without."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from scan3d_twin.core.moving_windows import are_all, moving_maximum, moving_mean, open_by_box


@pytest.mark.parametrize("size", [1, 2, 5, 8, 70])
@pytest.mark.parametrize("axis", [0, 1])
def test_means_are_the_same_bits(size: int, axis: int) -> None:
    values = np.random.default_rng(0).normal(size=(30, 41))
    wanted = ndimage.uniform_filter1d(values, size, axis=axis)
    assert np.array_equal(moving_mean(values, size, axis), wanted)


def test_maxima_see_what_is_infinite_and_the_border() -> None:
    rng = np.random.default_rng(0)
    values = np.where(rng.random((30, 41)) < 0.05, -np.inf, rng.normal(size=(30, 41)))
    wanted = ndimage.maximum_filter(values, 5, mode="constant", cval=np.inf)
    assert np.array_equal(moving_maximum(values, 5), wanted)


@pytest.mark.parametrize("size", [1, 2, 3, 8, 50])
def test_windows_are_whole_where_an_erosion_leaves_something(size: int) -> None:
    mask = np.random.default_rng(0).random((30, 41)) < 0.8
    for beyond in (False, True):
        for axis, box in enumerate([(size, 1), (1, size)]):
            wanted = ndimage.binary_erosion(mask, np.ones(box), border_value=beyond)
            assert np.array_equal(are_all(mask, size, axis, beyond), wanted)


@pytest.mark.parametrize("sizes", [(1, 1), (3, 2), (4, 7), (2, 50)])
def test_an_opening_keeps_what_boxes_cover(sizes: tuple[int, int]) -> None:
    mask = np.random.default_rng(0).random((30, 41)) < 0.9
    eroded = ndimage.binary_erosion(mask, np.ones(sizes), border_value=1)
    wanted = ndimage.binary_dilation(eroded, np.ones(sizes))
    assert np.array_equal(open_by_box(mask, sizes), wanted)
