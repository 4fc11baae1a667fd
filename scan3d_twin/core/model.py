"""The model of the target: all views' target points in one frame."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, IntArray


def fuse(session: Session) -> tuple[FloatArray, IntArray]:
    """Return the target's points (n, 3) in ``world`` [m] and the index of the view of each (n,)."""
    clouds = [view.T_world_scan.apply(view.target.points) for view in session.views]
    views = [np.full(len(cloud), k) for k, cloud in enumerate(clouds)]
    if not clouds:
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    return np.concatenate(clouds), np.concatenate(views)


def voxel_thin(points: FloatArray, size: float) -> FloatArray:
    """Return the mean point (m, 3) of each occupied voxel of side ``size`` [m]."""
    if len(points) == 0:
        return points
    cells = np.floor(points / size).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    count = np.bincount(index)
    return np.stack([np.bincount(index, points[:, i]) / count for i in range(3)], axis=1)
