"""Do two sweeps contradict each other? A surface cannot stand where the other scan saw through.

Each surfel of one scan is looked up in the other. In front of what is measured there, or where
nothing returned, it is a violation; on it, it counts by its squared distance; behind it is hidden
and says nothing. Counted both ways, a wrong period of a regular surface fits on the surface itself
but sticks out at its ends. ``native/free_space.h`` computes it.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfel_grid import Sample, SurfelGrid
from scan3d_twin.core.types import FloatArray


def contradiction(target: SurfelGrid, source: SurfelGrid, T: FloatArray, stride: int) -> float:
    """Return the mean violation, 0..1, of the surfels that each scan sees of the other at ``T``.

    Args:
        target: A sweep.
        source: Another.
        T: ``T_target_source`` (4, 4).
        stride: Of the surfels along lines and beams.
    """
    back = np.asarray(np.linalg.inv(T), dtype=np.float64)
    cost, seen = _violations(target, source.sample(stride), T)
    cost_back, seen_back = _violations(source, target.sample(stride), back)
    return (cost + cost_back) / max(1, seen + seen_back)


def _violations(grid: SurfelGrid, sample: Sample, T: FloatArray) -> tuple[float, int]:
    """Return the sum of the violations, and how many surfels a reading knows something of."""
    seen = np.zeros(1, dtype=np.int64)
    T = np.ascontiguousarray(T)
    cost = engine.violations(grid.target, grid.known, sample.value, T, seen)
    return float(cost), int(seen[0])
