"""What the scans alone say of a pose: a registration without its prior.

A registration is a maximum-a-posteriori estimate x with information matrix L, based on a prior of
mean x0 and information L0. The prior is removed again, so that odometry counts only once:

    L_d = L - L0,   x_d = x + L_d^+ L0 (x - x0).

An ambiguous pair, where several basins fit, adds little to its prior: the smaller the gap between
their scores, the more of the prior's covariance is added to its own.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration import PosePrior
from scan3d_twin.core.registration.multistart import MIN_CONTRADICTION_GAP
from scan3d_twin.core.registration.pose_prior import PLANAR, shift_to_target
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult

MIN_INFORMATION_SHARE = 0.05
"""Information of the scans, as a share of the prior's, below which a direction is left out."""


def remove_prior(result: RegistrationResult, prior: PosePrior) -> tuple[Pose2, FloatArray]:
    """Return mean and information matrix (3, 3) of a registration without its prior.

    Both are about the target's origin along its axes; the equations are in the module's docstring.
    In the metric of the prior, L0 = A^T A, the eigenvalues of A^-T L A^-1 are 1 plus the
    information that the scans add.
    """
    # Express the result in the prior's metric
    shift = shift_to_target(result.T_target_source)[np.ix_(PLANAR, PLANAR)]
    rows = list(PLANAR)
    deviation = shift @ prior.deviation(result.T_target_source)[rows]
    half = np.linalg.cholesky(shift @ prior.covariance[np.ix_(PLANAR, PLANAR)] @ shift.T)
    values, vectors = np.linalg.eigh(half.T @ result.information[np.ix_(PLANAR, PLANAR)] @ half)

    # Remove the prior where scans add information
    added = np.where(values - 1.0 > MIN_INFORMATION_SHARE, values - 1.0, 0.0)
    along = vectors.T @ np.linalg.solve(half, deviation)
    correction = half @ vectors @ np.divide(along, added, out=np.zeros(3), where=added > 0)

    # Weaken ambiguous results
    doubt = max(0.0, 1.0 - result.ambiguity_gap / MIN_CONTRADICTION_GAP)
    added = added / (1.0 + doubt * added)

    # Return to metres and radians
    back = np.linalg.solve(half.T, vectors)
    T = Pose2.from_matrix(result.T_target_source)
    moved = Pose2(float(correction[0]), float(correction[1]), float(correction[2])) @ T
    return moved, (back * added) @ back.T
