"""Which surface can be seen from where the robot can stand."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.model.coverable import _find_faced, _find_row_ends


def test_the_ends_of_the_rows_face_what_any_place_faces() -> None:
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(-4.0, 5.0), np.arange(-3.0, 4.0)), -1).reshape(-1, 2)
    eyes = np.insert(grid[rng.random(len(grid)) < 0.5], 2, 0.1, axis=1)
    surface, normals = rng.normal(size=(2, 500, 3)) * 3.0
    wanted = ((eyes[None] - surface[:, None]) * normals[:, None]).sum(axis=-1).max(axis=1) > 0
    assert 0.1 < wanted.mean() < 0.9
    assert np.array_equal(_find_faced(surface, normals, eyes), wanted)
    assert len(_find_row_ends(eyes)) < len(eyes)


def test_a_single_place_is_both_ends() -> None:
    assert _find_row_ends(np.array([[1.0, 2.0, 0.1]])).tolist() == [0]
