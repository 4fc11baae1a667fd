"""What the page of a run can colour the points of a model by, besides view and height."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.model.evaluation import Comparison
from scan3d_twin.core.model.fused_cloud import Model, number_voxels
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, IntArray

SEEN_VOXEL = 0.03
"""Side of the voxels in which the views that saw a point are counted [m]: readings on a surface at
2 m and 60 deg are 25 mm apart."""


@dataclass(frozen=True, eq=False)
class PointValues:
    """A figure of each point.

    Attributes:
        name: What a page calls it.
        unit: Its unit; empty for a number.
        values: The figures (n,), in ``unit``.
        low: Figure at the lower end of the colours.
        high: Figure at the upper end; larger ones look like it.
    """

    name: str
    unit: str
    values: FloatArray
    low: float
    high: float

    def to_bytes(self) -> IntArray:
        """Return the values as 0..255 between ``low`` and ``high`` (n,); the highest if unknown."""
        share = (self.values - self.low) / (self.high - self.low)
        return np.round(255 * np.clip(np.nan_to_num(share, nan=1.0), 0.0, 1.0)).astype(np.int64)


def measure_points(
    model: Model, session: Session, comparison: Comparison | None
) -> tuple[PointValues, ...]:
    """Return what is known of each point of ``model``; errors only with a ``comparison``."""
    epsilon, views = 1e3 * session.config.planning.epsilon, len(session.views)
    seen = count_views(model).astype(np.float64)
    expected = 1e3 * expect_errors(model, session)
    found = [
        PointValues("views that saw it", "", seen, 0.0, max(2.0, min(views, seen.max(initial=0)))),
        PointValues("expected error", "mm", expected, 0.0, 2.0 * epsilon),
    ]
    if comparison is not None:
        distances = 1e3 * comparison.distances
        found.append(PointValues("distance to the truth", "mm", distances, 0.0, 2.0 * epsilon))
    return tuple(found)


def count_views(model: Model) -> IntArray:
    """Return how many views have a point in the voxel of each point of ``model`` (n,)."""
    if len(model) == 0:
        return np.zeros(0, dtype=np.int64)
    voxel = number_voxels(model.points, SEEN_VOXEL)
    pairs = np.unique(np.column_stack([voxel, model.view]), axis=0)
    return np.asarray(np.bincount(pairs[:, 0])[voxel], dtype=np.int64)


def expect_errors(model: Model, session: Session) -> FloatArray:
    """Return the standard deviation expected of each point of ``model`` (n,) [m].

    The noise of its reading and, summed in squares, the calibrated errors of the registrations from
    the first view to its own; infinite where one of them determined nothing.
    """
    factor, total, poses = session.config.registration.calibration, 0.0, []
    for view in session.views:
        result = view.registration
        if result is not None:
            error = factor * result.predicted_rmse if result.converged else math.inf
            total += math.inf if math.isnan(error) else error**2
        poses.append(total)
    return np.asarray(np.sqrt(model.sigma**2 + np.array(poses)[model.view]))
