"""Motion error model (paper eq. 2): where the robot ends up instead of at the planned viewpoint.

The errors along x and y and of the heading are normal, with standard deviations proportional to the
move: lambda per metre and gamma per radian. The prior of a real registration has the same two
constants and the drift besides (``mapping.motion_prior``).
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.types import FloatArray, Pose2


def sample_motion_noise(
    overlaps: int, config: PlanningConfig, rng: np.random.Generator
) -> FloatArray:
    """Return standard normal numbers (overlaps, trials, 3) from which motion errors are made.

    With ``planning.draws`` common, all overlaps share the same numbers. Independent numbers would
    give a search over seven overlaps seven chances that one lucky draw ends it.
    """
    if config.draws == "independent":
        return rng.standard_normal((overlaps, config.trials, 3))
    return np.broadcast_to(rng.standard_normal((config.trials, 3)), (overlaps, config.trials, 3))


def scale_motion_error(draw: FloatArray, viewpoint: Pose2, config: PlanningConfig) -> Pose2:
    """Return R and T of eq. (2): errors proportional to the move along x and y and to the turn.

    Args:
        draw: Standard normal numbers for x, y and yaw (3,).
        viewpoint: The candidate O2 in frame ``scan`` of the latest view, where O1 is the origin.
        config: Its ``lambda_`` and ``gamma`` scale the draw.
    """
    x, y, yaw = draw
    return Pose2(
        x * config.lambda_ * abs(viewpoint.x),
        y * config.lambda_ * abs(viewpoint.y),
        yaw * config.gamma * abs(viewpoint.yaw),
    )
