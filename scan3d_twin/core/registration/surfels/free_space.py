"""Free-space violations between two sweeps: no surface can stand where the other sweep saw through.

Each surfel of one sweep is projected into the other. In front of the surface measured there, or on
an empty ray within the lidar's range, it is a violation; near that surface it counts by its squared
distance; behind it, it is occluded and counts nothing. Both directions are summed: a periodic
surface registered one period off fits along the surface but protrudes at its ends.
``native/free_space.h`` computes it.

A single pose is judged by what lies in front of a measured surface. An empty ray may have failed
(out of range, too flat, too dark), but one that met a surface has passed through all that is in
front of it. At a right pose next to nothing lies there, however little the sweeps share; where one
is matched with another surface, something does, unless both places look alike from end to end.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.grid import Sample, SurfelGrid
from scan3d_twin.core.types import FloatArray

MAX_CONTRADICTION = 0.02
"""Largest share of either sweep in front of the other's surfaces at a right pose: right pairs of
closed loops have up to 0.005 (595 pairs), in the world ``harsh`` 0.011 (155); wrong ones have 0.12
to 0.64 (8), sweeps of opposite sides of a room 0.01 to 0.34 (40)."""


def measure_contradiction(
    target: SurfelGrid, source: SurfelGrid, T: FloatArray, stride: int
) -> float:
    """Return the mean free-space violation, 0..1, of the surfels each sweep sees of the other.

    Args:
        target: A sweep.
        source: Another sweep.
        T: Pose ``T_target_source`` to judge (4, 4).
        stride: Every ``stride``-th surfel along lines and beams takes part.
    """
    back = np.asarray(np.linalg.inv(T), dtype=np.float64)
    cost, seen = _sum_violations(target, source.sample(stride), T)
    cost_back, seen_back = _sum_violations(source, target.sample(stride), back)
    return (cost + cost_back) / max(1, seen + seen_back)


def find_contradicted_share(
    target: SurfelGrid, source: SurfelGrid, T: FloatArray, stride: int
) -> float:
    """Return the share of a sweep that lies in front of the other's surfaces, 0..1.

    It is that of the surfels on whose rays the other sweep met a surface; of both sweeps the larger
    one. What the lines before and after met must lie behind a surfel, too: the space between two
    lines was not seen.

    Args:
        target: A sweep.
        source: Another sweep.
        T: Pose ``T_target_source`` to judge (4, 4).
        stride: Every ``stride``-th surfel along lines and beams takes part.
    """
    share = engine.find_contradicted_share(
        target.target, target.sample(stride).value,
        source.target, source.sample(stride).value, np.ascontiguousarray(T),
    )  # fmt: skip
    if share < 0:
        raise MemoryError
    return float(share)


def _sum_violations(grid: SurfelGrid, sample: Sample, T: FloatArray) -> tuple[float, int]:
    """Return the sum of the violations and the number of surfels on rays that are not unknown."""
    seen = np.zeros(1, dtype=np.int64)
    T = np.ascontiguousarray(T)
    reach = grid.image.spec.max_range
    cost = engine.sum_violations(grid.target, grid.ray_states, reach, sample.value, T, seen)
    return float(cost), int(seen[0])
