"""Score of an episode by the truth: coverage and registration errors, updated view by view.

The definitions are those of ``core.model.evaluation``, on coarser samples and incremental. The
score enters rewards and metrics, never an observation.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.model.evaluation import COVERAGE_DISTANCE
from scan3d_twin.core.model.fused_cloud import find_supported, thin_by_voxel
from scan3d_twin.core.model.pose_errors import find_true_pose, measure_displacement
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.registration.kd_tree import is_near
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.envs.prepared_scenes import PreparedScene, find_coverable

INCLUSIVE_FACTOR = 1 + 1e-9
"""Factor on a radius, so that a point at exactly this distance counts."""
MAX_POINTS = 500
"""Points over which a registration error is averaged."""


class Score:
    """Coverage by all views of an episode, and their registration errors."""

    def __init__(self, prepared: PreparedScene, truth: Truth, session: Session) -> None:
        self._truth, self._prepared = truth, prepared
        wanted = find_coverable(prepared, session.config)
        self._surface, self._covered = (
            prepared.surface.points[wanted],
            np.zeros(int(wanted.sum()), bool),
        )
        self._placed: list[Pose2] = []
        self._true: list[Pose2] = []
        self.errors: list[float] = []

    @property
    def coverage(self) -> float:
        """Share of the coverable samples within ``COVERAGE_DISTANCE`` of the model.

        0 where nothing can be covered: it would be a reward for nothing.
        """
        return float(np.mean(self._covered)) if len(self._covered) else 0.0

    def update(self, session: Session) -> None:
        """Update coverage and errors with the latest view of ``session``."""
        views = session.views
        self._true += [find_true_pose(view, self._truth) for view in views[len(self._true) :]]
        if len(views) > 1:
            self.errors.append(self._error(session, len(views) - 1))
        known = [view.T_world_scan for view in views[: len(self._placed)]]
        moved = known != self._placed  # realigned: recompute the coverage
        if moved:
            self._covered[:] = False
        T_map_world = self._true[0] @ views[0].T_world_scan.inverse()
        for view in views if moved else views[len(self._placed) :]:
            self._cover((T_map_world @ view.T_world_scan).apply(view.target.points))
        self._placed = [view.T_world_scan for view in views]

    def f_score(self, session: Session, distance: float = 0.020) -> float:
        """Return the F-score of the model at ``distance`` [m]; 0 for an empty one."""
        model = np.concatenate(
            [
                view.T_world_scan.apply(view.target.points[find_supported(view)])
                for view in session.views
            ]
        )
        if len(model) == 0:
            return 0.0
        T_map_world = self._true[0] @ session.views[0].T_world_scan.inverse()
        thin = thin_by_voxel(T_map_world.apply(model), distance / 2)
        precision = float(np.mean(self._prepared.surface.within(thin, distance)))
        recall = self._recall(thin, distance)
        return 2 * precision * recall / (precision + recall) if precision + recall else 0.0

    def _recall(self, model: FloatArray, distance: float) -> float:
        if not len(self._surface):
            return 0.0
        return float(np.mean(is_near(self._surface, model, distance * INCLUSIVE_FACTOR)))

    def _cover(self, points: FloatArray) -> None:
        """Mark the samples near ``points`` (n, 3) in ``map``."""
        open_ = np.flatnonzero(~self._covered)
        if len(points) == 0 or len(open_) == 0:
            return
        near = is_near(self._surface[open_], points, COVERAGE_DISTANCE * INCLUSIVE_FACTOR)
        self._covered[open_[near]] = True

    def _error(self, session: Session, k: int) -> float:
        """Return the registration error of view ``k`` [m]; over its sweep without a target."""
        previous, view = session.views[k - 1], session.views[k]
        points = view.target.points if len(view.target) else view.sweep.points
        points = points[:: max(1, len(points) // MAX_POINTS)]
        true = self._true[k - 1].inverse() @ self._true[k]
        placed = previous.T_world_scan.inverse() @ view.T_world_scan
        return measure_displacement(points, placed, true)
