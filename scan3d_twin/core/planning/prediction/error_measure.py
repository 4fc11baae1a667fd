"""Error measure E of a simulated registration (paper eq. 3), which is compared with epsilon."""

from __future__ import annotations

import math

from scan3d_twin.core.planning_config import Criterion
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult, rms


def measure_error(
    result: RegistrationResult,
    R_T: Pose2,
    Q_prime: FloatArray,
    Q_virtual: FloatArray,
    criterion: Criterion,
) -> float:
    """Return the error E [m] of one simulated registration; infinite without correspondences.

    ``displacement`` and ``eq3`` compare points index by index, without and with the noise of the
    virtual scan; ``nn`` is the residual of the nearest neighbours.

    Args:
        result: The registration of the virtual scan Q'' on Q.
        R_T: The motion error that the virtual scan was displaced by, eq. (2).
        Q_prime: Points Q' (n, 3) that the virtual scan was made from, eq. (5) [m].
        Q_virtual: The virtual scan Q'' (n, 3), eq. (6) [m].
        criterion: ``planning.criterion``.
    """
    if result.num_inliers == 0:
        return math.inf
    T = Pose2.from_matrix(result.T_target_source)
    if criterion == "displacement":
        return rms((T @ R_T).apply(Q_prime) - Q_prime)
    if criterion == "eq3":
        return rms(T.apply(Q_virtual) - Q_prime)
    return result.inlier_rmse
