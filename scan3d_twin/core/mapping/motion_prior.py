"""The motion prior: the distribution of a move of which each error is drawn anew."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.registration import PosePrior
from scan3d_twin.core.types import FloatArray, Pose2, wrap

MIN_SIGMA_XY, MIN_SIGMA_YAW = 0.003, math.radians(0.2)
"""Standard deviations of a move of no length [m], [rad]: play of the wheels and the turning
centre."""


def motion_prior(move: Pose2, config: PlanningConfig, scale: float = 1.0) -> PosePrior:
    """Return the prior of a move by turn, drive and turn, about the viewpoint it leads to.

    It takes each error of each move as drawn anew. Let D be the length of the drive and t1, t2 the
    turns before and after it. The standard deviations are

    * lambda D along the drive;
    * lambda D, D gamma t1 and delta D^2 / 2 across it, as the heading is off by gamma t1 at its
      start and drifts by delta D until its end;
    * gamma (t1 + t2) and delta D of the final heading,

    all independent of each other and multiplied by ``scale``.

    Args:
        move: The move ``T_previous_next``.
        config: Its ``lambda_``, ``gamma`` and ``drift`` (delta).
        scale: Factor on all errors, see ``MotionModel.of``.
    """
    return PosePrior.of_robot(
        move, scale**2 * sum_variances(move, config, MIN_SIGMA_XY, MIN_SIGMA_YAW)
    )


def sum_variances(
    move: Pose2, config: PlanningConfig, sigma_xy: float, sigma_yaw: float
) -> FloatArray:
    """Return the covariance (3, 3) of ``motion_prior``.

    Args:
        move: The move.
        config: Its ``lambda_``, ``gamma`` and ``drift``.
        sigma_xy: Standard deviation of a move of no length [m].
        sigma_yaw: That of its heading [rad].
    """
    # Split the move and its errors
    D = math.hypot(move.x, move.y)
    bearing = math.atan2(move.y, move.x) if D > 0.01 else 0.0
    before, after = config.gamma * abs(bearing), config.gamma * abs(wrap(move.yaw - bearing))
    drift, slip = config.drift * D, config.lambda_ * D

    # Sum up variances along the drive
    C = np.zeros((3, 3))
    C[0, 0] = slip**2 + sigma_xy**2
    C[1, 1] = slip**2 + (D * before) ** 2 + (drift * D / 2) ** 2 + sigma_xy**2
    C[2, 2] = (before + after) ** 2 + drift**2 + sigma_yaw**2
    C[1, 2] = C[2, 1] = D * before * before + drift * drift * D / 2

    # Turn them into the frame
    along = Pose2(0.0, 0.0, bearing).matrix()[:3, :3]
    return along @ C @ along.T
