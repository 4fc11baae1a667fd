"""Free-space violations: no surface can stand where the other sweep saw through.

Each surfel of one scan is looked up in the other. In front of what is measured there, or where
nothing returned, it is a violation; on it, it counts by its squared distance; behind it is hidden
and says nothing. Counted both ways, a wrong period of a regular surface fits on the surface itself
but sticks out at its ends.
"""

from __future__ import annotations

import numpy as np

from reference.projection import lookup
from reference.scan_arrays import Target
from reference.surfels import EMPTY, SURFACE, UNKNOWN, VARIANCE, N, X
from scan3d_twin.core.types import FloatArray, SmallIntArray

MARGIN = 0.02
"""Distance in front of a surface that is a full violation [m] ..."""
SIGMAS = 3.0
"""... or in standard deviations, whichever is larger."""
RANGE_SHARE = 0.95
"""Share of the lidar's range within which an empty ray misses what a surface would have shown."""


def violations(
    target: Target, known: SmallIntArray, max_range: float, rows: FloatArray, T: FloatArray
) -> tuple[float, int]:
    """Return the sum of the violations, and how many surfels a reading says something of.

    Args:
        target: The scan that is asked.
        known: What each of its readings says of its ray (n,).
        max_range: Range of its lidar [m]; what may be farther off is not missed by an empty ray.
        rows: Surfels of the other scan (m, 8).
        T: ``T_target_source`` (4, 4).
    """
    points = rows[:, X] @ T[:3, :3].T + T[:3, 3]
    at = lookup(target.projection, points, known != UNKNOWN)
    state, met = np.where(at >= 0, known[at], UNKNOWN), target.rows[target.row_of[at]]
    lidar = target.projection.mount[5:8]
    far = np.linalg.norm(points - [0, 0, lidar[2]], axis=1) + np.hypot(*lidar[:2])
    state = np.where((state == EMPTY) & (far >= RANGE_SHARE * max_range), UNKNOWN, state)
    e = np.sum(met[:, N] * (points - met[:, X]), axis=1)
    margin = np.maximum(MARGIN, SIGMAS * np.sqrt(rows[:, VARIANCE] + met[:, VARIANCE]))
    hit = np.where(e < -margin, 0.0, np.minimum(1.0, (e / margin) ** 2))
    cost = np.where(state == SURFACE, hit, np.where(state == EMPTY, 1.0, 0.0))
    return float(cost.sum()), int(np.count_nonzero(state != UNKNOWN))


def share_in_front(target: Target, rows: FloatArray, T: FloatArray) -> float:
    """Return the share of surfels in front of what the target met on their rays, 0..1.

    What the lines before and after met must lie behind them, too.

    Args:
        target: The scan that is asked.
        rows: Surfels of the other scan (m, 8).
        T: ``T_target_source`` (4, 4).
    """
    points = rows[:, X] @ T[:3, :3].T + T[:3, 3]
    at = lookup(target.projection, points, target.row_of >= 0)
    seen = (at >= 0) & (target.row_of[at] >= 0)
    beams = target.projection.yaws.shape[1]
    in_front = np.ones(len(rows), dtype=bool)
    for beside in (at - beams, at, at + beams):
        inside = (beside >= 0) & (beside < len(target.row_of))
        row = np.where(inside, target.row_of[np.where(inside, beside, 0)], -1)
        met = target.rows[row]
        e = np.sum(met[:, N] * (points - met[:, X]), axis=1)
        margin = np.maximum(MARGIN, SIGMAS * np.sqrt(rows[:, VARIANCE] + met[:, VARIANCE]))
        in_front &= (row >= 0) & (e >= margin)
    return float(np.mean(in_front[seen])) if seen.any() else 0.0
