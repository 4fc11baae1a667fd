"""Grids grown and shrunk as the distance transform says, and ways as long as they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import csgraph

from scan3d_twin.core.grids import dilate, erode, find_connected, find_shortest_paths

RADII = (0.0, 0.5, 1.0, 1.5, 2.3, 3.0, math.hypot(2, 3), 7.4, 40.0)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("share", [0.002, 0.1, 0.9])
def test_grown_and_shrunk_as_the_distance_transform_says(radius: float, share: float) -> None:
    grid = np.random.default_rng(3).random((31, 44)) < share
    grid[20, 30] = True
    away = ndimage.distance_transform_edt(~grid)
    assert np.array_equal(dilate(grid, radius), away <= radius)
    assert np.array_equal(dilate(grid, 0.05 * radius, 0.05), away * 0.05 <= 0.05 * radius)
    inside = ndimage.distance_transform_edt(np.pad(grid, 1))[1:-1, 1:-1]
    assert np.array_equal(erode(grid, radius), inside > radius)


def test_nothing_grows_from_nothing_or_by_less_than_nothing() -> None:
    nothing, one = np.zeros((4, 5), dtype=bool), np.eye(4, dtype=bool)
    assert not dilate(nothing, 9.0).any()
    assert not erode(nothing, 1.0).any()
    assert not dilate(one, -0.1).any()


def test_a_wall_cuts_off_and_a_corner_does_not() -> None:
    grid = np.ones((5, 7), dtype=bool)
    grid[:, 3] = False
    assert find_connected(grid, (0, 0)).sum() == 15
    grid[2, 3] = True
    assert find_connected(grid, (0, 0)).sum() == 31
    assert find_connected(np.eye(4, dtype=bool), (0, 0)).sum() == 4


def test_ways_lead_back_to_the_start_by_the_length_they_state() -> None:
    grid = np.ones((6, 9), dtype=bool)
    grid[1:, 4] = False
    way, before = find_shortest_paths(grid, (5, 0), 0.05)
    end = np.ravel_multi_index((5, 8), grid.shape)
    assert way[end] == pytest.approx(0.05 * (8 * math.sqrt(2) + 2))
    cells, length = [int(end)], 0.0
    while before[cells[-1]] >= 0:
        cells.append(int(before[cells[-1]]))
        i, j = np.unravel_index(cells[-2:], grid.shape)
        length += 0.05 * math.hypot(i[1] - i[0], j[1] - j[0])
    assert cells[-1] == np.ravel_multi_index((5, 0), grid.shape)
    assert length == pytest.approx(way[end])
    assert np.isinf(way.reshape(grid.shape)[~grid]).all()


def test_ways_are_as_long_as_those_of_another_program() -> None:
    grid = np.random.default_rng(1).random((40, 60)) < 0.7
    grid[0, 0] = True
    grid = find_connected(grid, (0, 0))
    way, before = find_shortest_paths(grid, (0, 0), 0.05)
    cells = np.argwhere(grid)
    apart = np.abs(cells[:, None] - cells)
    steps = np.where(apart.max(axis=2) == 1, 0.05 * np.hypot(apart[..., 0], apart[..., 1]), 0.0)
    assert np.array_equal(way[grid.ravel()], csgraph.dijkstra(steps, indices=0))
    assert np.all((before >= 0) == (grid.ravel() & (way > 0)))
