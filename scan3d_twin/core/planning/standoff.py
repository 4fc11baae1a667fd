"""The standoff for a target, by its height in the first panorama.

The vertical field of view that is modelled ends at a height of z + d tan(window / 2) at the
distance d, with z the height of the lidar: 1.07 m at 1 m. A higher target is seen from farther
away. The top of a low one is seen flatly, at an angle of atan((z - h) / d); it is seen from nearer
if that opens the angle to ``MIN_TOP_ANGLE``.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.types import FloatArray, Observation

NEAR_TARGET = 0.05
"""Distance in the top view within which a reading is of the target [m]."""
TOP_READINGS = 5
"""Number of readings above a height from which it counts as surface, not as stray readings."""
EDGE_ANGLE = math.radians(1.0)
"""Angle kept between the top of a target and the edge of the window [rad]: three beams."""
MIN_TOP_ANGLE = math.radians(15.0)
"""Smallest angle to a top at which it is seen [rad]; at less the URG-04LX errs grossly."""
MIN_STANDOFF, MAX_STANDOFF = 0.6, 2.0
"""Smallest and largest standoff that is chosen [m]: what the robot needs to turn and to plan a path
in, and half of the range, beyond which lines are 17 mm apart."""


def fit_standoff(config: Config, panorama: Observation, hint: FloatArray) -> Config:
    """Return ``config`` with the standoff for the target, if ``planning.standoff_rule`` wants it.

    Args:
        config: The effective configuration.
        panorama: The first panorama.
        hint: Top view of the target in ``odom`` (n, 2) [m].
    """
    planning = config.planning
    if planning.standoff_rule == "fixed":
        return config
    height = measure_height(panorama, hint, config.target)
    lidar = float(panorama.image.T_base_lidar[2, 3])
    standoff = choose_standoff(planning.standoff, height, lidar, config.target.window)
    return replace(config, planning=replace(planning, standoff=standoff))


def choose_standoff(wanted: float, height: float, lidar: float, window: float) -> float:
    """Return the standoff [m] from which a target is seen up to its top.

    Args:
        wanted: The configured standoff [m], which is kept unless another one shows more.
        height: Height of the target [m]; NaN where it is not known.
        lidar: Height of the lidar [m].
        window: Vertical field of view [rad].
    """
    if not math.isfinite(height):
        return wanted
    farther = (height - lidar) / math.tan(window / 2 - EDGE_ANGLE)
    if farther > wanted:
        return max(wanted, min(farther, MAX_STANDOFF))
    nearer = (lidar - height) / math.tan(MIN_TOP_ANGLE)
    return nearer if MIN_STANDOFF <= nearer < wanted else wanted


def measure_height(panorama: Observation, hint: FloatArray, config: TargetConfig) -> float:
    """Return the height [m] of the target in a panorama; NaN where it is not seen.

    What hangs over it, such as a ceiling, does not count.

    Args:
        panorama: The panorama, with all its beams.
        hint: Top view of the target in ``odom`` (n, 2) [m].
        config: Its ``cluster_gap`` separates, its ``max_range`` and ``floor_height`` limit.
    """
    # Select the readings near the target
    image = panorama.image
    points = image.points[image.ranges < config.max_range]
    points = points[points[:, 2] > config.floor_height]
    if len(points) == 0 or len(hint) == 0:
        return math.nan
    near = Tree.of(hint).is_near(panorama.T_odom_scan.apply(points[:, :2]), NEAR_TARGET)

    # Follow them upwards to the first gap
    heights = np.sort(points[near, 2])
    gaps = np.flatnonzero(np.diff(heights) > config.cluster_gap)
    heights = heights[: gaps[0] + 1] if len(gaps) else heights
    return float(heights[-TOP_READINGS]) if len(heights) >= TOP_READINGS else math.nan
