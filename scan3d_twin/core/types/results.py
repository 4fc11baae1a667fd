"""Results of registration and planning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.options import renamed
from scan3d_twin.core.types.arrays import FloatArray, read_only
from scan3d_twin.core.types.pose import Pose2


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """The pose of a source scan in a target scan, and its uncertainty.

    Attributes:
        T_target_source: The pose (4, 4).
        covariance: Covariance of x, y, z [m] and rx, ry, rz [rad] about the target's origin (6, 6);
            without a prior infinite where an undetermined direction points.
        information: Information matrix (6, 6): the inverse of the covariance on the estimated
            directions, 0 on the others.
        fitness: Share of source points with a correspondence, 0..1.
        inlier_rmse: Root mean square distance of the correspondences [m].
        predicted_rmse: Expected root mean square displacement of the source points [m].
        num_inliers: Number of correspondences.
        iterations: Iterations run.
        converged: Whether the result may be used.
        degenerate_directions: Unit directions (k, 6) that the data do not determine.
        ambiguity_gap: Score distance to the next best basin, 0..1, 1 if several starts met in one;
            NaN where a single start looked for no other.
        shared_spread: Errors that all readings share (a curve of the range error, the floor, the
            yaw scale), as a multiple of the usual ones; NaN where they were not estimated.

    >>> result = session.views[1].registration
    >>> result.converged, result.covariance.shape, bool(result.predicted_rmse < 0.01)
    (True, (6, 6), True)
    """

    T_target_source: FloatArray
    covariance: FloatArray
    information: FloatArray
    fitness: float
    inlier_rmse: float
    predicted_rmse: float
    num_inliers: int
    iterations: int
    converged: bool
    degenerate_directions: FloatArray
    ambiguity_gap: float
    shared_spread: float = math.nan

    @staticmethod
    def unregistered(
        T: FloatArray, covariance: FloatArray, information: FloatArray
    ) -> RegistrationResult:
        """Return the result for scans that cannot be registered: the initial guess as it was.

        Args:
            T: The initial guess (4, 4).
            covariance: Its covariance (6, 6).
            information: Its information matrix (6, 6).
        """
        return RegistrationResult(
            T_target_source=T,
            covariance=covariance,
            information=information,
            fitness=0.0,
            inlier_rmse=math.nan,
            predicted_rmse=math.nan,
            num_inliers=0,
            iterations=0,
            converged=False,
            degenerate_directions=read_only(np.zeros((0, 6))),
            ambiguity_gap=math.nan,
        )


@dataclass(frozen=True, slots=True)
class Candidate:
    """One viewpoint that a planner considered.

    Attributes:
        viewpoint: ``T_world_scan`` of the sweep that would be taken there.
        overlap: The paper's eta: share of the current target lines that are seen again.
        predicted_rmse: Predicted registration error E [m]; NaN where it was not predicted.
        feasible: Whether the robot can reach it and stand there.
    """

    viewpoint: Pose2
    overlap: float
    predicted_rmse: float
    feasible: bool


@dataclass(frozen=True, slots=True)
class Plan:
    """The decision of a planner and its reason.

    Attributes:
        viewpoint: ``T_world_scan`` of the next sweep; None when the scan is finished.
        overlap: The chosen eta; 0 when finished.
        predicted_rmse: E of the chosen overlap [m]; NaN when unknown.
        fell_back: Whether no viewpoint met epsilon, so that the one nearest to it was taken.
        candidates: All viewpoints that were considered, in that order.
        reason: Why the planner decided so, in words.
        needs_panorama: Whether a panorama from here may show that a better viewpoint is free.
        half_width: Half the angle of the sweep there [rad]; None for all of it.
        beyond: Angle swept beyond that to one side, to the left where positive [rad]: it shows the
            floor of the next move.

    >>> plan = session.plans[0]
    >>> plan.viewpoint is not None, 0.0 < plan.overlap < 1.0
    (True, True)
    """

    viewpoint: Pose2 | None
    overlap: float
    predicted_rmse: float
    fell_back: bool
    candidates: tuple[Candidate, ...]
    reason: str
    needs_panorama: bool = renamed(False, "needs_look")
    half_width: float | None = None
    beyond: float = 0.0
