"""Do two sweeps contradict each other? A surface cannot stand where the other scan saw through.

Each surfel of one scan is looked up in the other. In front of what is measured there, or where
nothing returned, it is a violation; on it, it counts by its squared distance; behind it is hidden
and says nothing. Counted both ways, a wrong period of a regular surface fits on the surface itself
but sticks out at its ends.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.compiled import compiled
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.surfel_grid import SurfelGrid
from scan3d_twin.core.registration.surfels import EMPTY, SURFACE, UNKNOWN, VARIANCE, N, X
from scan3d_twin.core.types import FloatArray, IntArray

MARGIN = 0.02
"""In front by this much is a full violation [m], or by ..."""
SIGMAS = 3.0
"""... this many standard deviations, whichever is more."""


def contradiction(target: SurfelGrid, source: SurfelGrid, T: FloatArray, stride: int) -> float:
    """Return the mean violation, 0..1, of the surfels that each scan sees of the other at ``T``."""
    R, t = T[:3, :3], T[:3, 3]
    back = np.concatenate([R.T, -(R.T @ t)[:, None]], axis=1)
    cost, seen = _one_way(target, source, np.ascontiguousarray(T[:3]), stride)
    cost_back, seen_back = _one_way(source, target, back, stride)
    return (cost + cost_back) / max(1, seen + seen_back)


def _one_way(
    target: SurfelGrid, source: SurfelGrid, T: FloatArray, stride: int
) -> tuple[float, int]:
    run, p = compiled("violations") or violations, target.projection
    rows = source.sample(stride).rows
    cost, seen = run(
        target.table.reshape(-1, 8), target.known, p.lines, p.beams, p.offsets, p.mount, rows, T
    )
    return float(cost), int(seen)


def violations(
    table: FloatArray,
    known: IntArray,
    lines: IntArray,
    beams: IntArray,
    offsets: FloatArray,
    mount: FloatArray,
    rows: FloatArray,
    T: FloatArray,
) -> tuple[float, int]:
    """Return the sum of the violations, and how many surfels a reading says something of.

    Args:
        table: The target's surfels (n, 8).
        known: What each reading says of its ray (n,).
        lines: With ``beams``, ``offsets`` and ``mount`` the target's ``Projection``.
        beams: See there.
        offsets: See there.
        mount: See there.
        rows: The source's surfels (m, 8).
        T: ``T_target_source`` (3, 4).
    """
    points = rows[:, X] @ T[:, :3].T + T[:, 3]
    index = Projection(lines, beams, offsets, mount).lookup(points, known)
    state = np.where(index >= 0, known[index], UNKNOWN)
    e = np.sum(table[index, N] * (points - table[index, X]), axis=1)
    margin = np.maximum(MARGIN, SIGMAS * np.sqrt(rows[:, VARIANCE] + table[index, VARIANCE]))
    hit = np.where(e < -margin, 0.0, np.minimum(1.0, (e / margin) ** 2))
    cost = np.where(state == SURFACE, hit, np.where(state == EMPTY, 1.0, 0.0))
    return float(cost.sum()), int(np.count_nonzero(state != UNKNOWN))
