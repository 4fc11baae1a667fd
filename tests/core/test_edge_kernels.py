"""The compiled search for vertical edges against the arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic

from scan3d_twin.core.registration import compiled as compiled_module
from scan3d_twin.core.registration.edges import Edges, edge_equations, find_edges
from scan3d_twin.core.registration.scan_noise import ScanNoise
from scan3d_twin.core.registration.surfel_grid import prepare
from scan3d_twin.core.types import Pose2

SIGMA, YAW_SIGMA = 0.005, math.radians(0.1)


def edges(pose: Pose2, seed: int, room: bool) -> Edges:
    rng = np.random.default_rng(seed)
    image = synthetic.observe(pose, synthetic.THREE_BOXES, room=room, sigma=SIGMA, rng=rng).image
    grid = prepare(image, noise=ScanNoise(SIGMA))
    return Edges.of(find_edges(image, grid.rows, grid.index, grid.valid, YAW_SIGMA))


@pytest.mark.parametrize("room", [False, True])
def test_arrays_and_compiled_loops_agree(room: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    first, second = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
    T = (first.inverse() @ second).matrix()
    fast = edges(first, 1, room), edges(second, 2, room)
    fast_sums = edge_equations(*fast, T, 0.05, 2.0)
    monkeypatch.setattr(compiled_module, "load_kernels", lambda: None)
    slow = edges(first, 1, room), edges(second, 2, room)
    for a, b in zip(fast, slow, strict=True):
        assert len(b) > 2
        assert a.rows == pytest.approx(b.rows, rel=1e-6, abs=1e-9)
    for a, b in zip(fast_sums, edge_equations(*slow, T, 0.05, 2.0), strict=True):
        assert np.abs(b).max() > 0
        assert a == pytest.approx(b, rel=1e-4, abs=1e-6 * np.abs(b).max())
