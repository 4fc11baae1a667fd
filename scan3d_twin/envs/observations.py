"""Observation space and observations: what the robot knows, as bounded arrays in a flat dictionary.

The truth is not available here: session, costmap and context are the robot's own.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from scan3d_twin.core.navigation.costmap import FREE, OBSTACLE, RESOLUTION, Costmap
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, wrap

SIDE = 96
"""Cells along each side of the top view: 4.8 m, the robot in the middle, heading up."""
LINES, BEAMS = 64, 96
"""Size of the observed range image."""
BINS = 64
"""Bearings of the profile, from left to right across a sweep."""
POSITION_SCALE = 5.0
"""Unit of observed positions [m]; they are clipped to -1 .. 1."""
TARGET_LOST = "target lost"
"""Start of a context's reason for finishing if there is no target in view."""
ERROR_SCALE = 5.0
"""Unit of observed errors, in epsilon; they are clipped to 0 .. 1."""
Image = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]


def observation_space() -> dict[str, spaces.Space[Any]]:
    """Return the observation spaces that all environments share."""
    return {
        "topdown": spaces.Box(0, 255, (4, SIDE, SIDE), np.uint8),
        "range": spaces.Box(0, 255, (1, LINES, BEAMS), np.uint8),
        "profile": spaces.Box(-1.0, 1.0, (4 * BINS,), np.float32),
        "pose": spaces.Box(-1.0, 1.0, (6,), np.float32),
        "stats": spaces.Box(0.0, 1.0, (8,), np.float32),
    }


def observe(context: PlanningContext) -> dict[str, Any]:
    """Return the observations in ``observation_space`` after the latest view."""
    session, view = context.session, context.view
    return {
        "topdown": encode_topdown(session, context.costmap),
        "range": encode_range_image(view, session.config.target.max_range),
        "profile": encode_profile(view, session).ravel(),
        "pose": encode_pose(session),
        "stats": encode_stats(context),
    }


def sees_target(context: PlanningContext) -> bool:
    """Return whether the latest view shows enough of the target to plan the next one."""
    return not (context.termination_reason() or "").startswith(TARGET_LOST)


def encode_topdown(session: Session, costmap: Costmap) -> Image:
    """Return free, obstacle, target and unknown (4, SIDE, SIDE) around the robot: 0 or 255."""
    scan = session.views[-1].observation.T_odom_scan
    steps = ((SIDE - 1) / 2 - np.arange(SIDE)) * RESOLUTION
    c, s = np.cos(scan.yaw) * steps, np.sin(scan.yaw) * steps
    nx, ny = costmap.cells.shape
    i = np.floor(((scan.x + c)[:, None] - s - costmap.origin[0]) / RESOLUTION).astype(np.int64)
    j = np.floor(((scan.y + s)[:, None] + c - costmap.origin[1]) / RESOLUTION).astype(np.int64)
    inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
    known = costmap.cells.ravel().take(i * ny + j, mode="clip")
    free, obstacle = inside & (known == FREE), inside & (known == OBSTACLE)
    layers = (free, obstacle, _target(session), ~(free | obstacle))
    return np.stack([layer.view(np.uint8) for layer in layers]) * np.uint8(255)


def _target(session: Session) -> BoolArray:
    """Return the cells of the top view where the target is known to be (SIDE, SIDE)."""
    back = session.views[-1].T_world_scan.inverse()
    local = back.apply(session.gather_known_target())
    i, j = np.floor(SIDE / 2 - np.ascontiguousarray(local.T) / RESOLUTION).astype(np.int64)
    inside = (i >= 0) & (i < SIDE) & (j >= 0) & (j < SIDE)
    shown = np.zeros((SIDE, SIDE), dtype=bool)
    shown[i[inside], j[inside]] = True
    return shown


def encode_range_image(view: View, most: float) -> Image:
    """Return the ranges (1, LINES, BEAMS): 0 for no return, 1 to 255 for 0 to ``most`` [m].

    Lines left to right, beams bottom to top, evenly sampled from the sweep.
    """
    ranges = view.observation.image.ranges
    rows = np.linspace(0, ranges.shape[0] - 1, LINES).astype(np.int64)
    columns = np.linspace(0, ranges.shape[1] - 1, BEAMS).astype(np.int64)
    shown = ranges[np.ix_(rows, columns)]
    grey = 1 + 254 * np.clip(np.nan_to_num(shown, nan=0.0) / most, 0.0, 1.0)
    return np.where(np.isfinite(shown), grey, 0.0).astype(np.uint8)[None]


def encode_profile(view: View, session: Session) -> Values:
    """Return the target's profile by bearing, left to right across the sweep (4, BINS).

    Rows: mean distance and depth, both per maximum range; height of the top [m], clipped; share of
    the readings in the bin that are on the target. Bins without target are -1, or 0 for the share.
    """
    config = session.config
    half = config.sweep.width / 2 + config.sweep.margin
    points, n = view.target.points, view.image.spec.n_beams

    # Bins without target.
    result = np.full((4, BINS), -1.0)
    result[3] = 0.0
    if len(points) == 0:
        return _clip(result, -1.0)

    # Extent by bearing.
    bearing = np.arctan2(points[:, 1], points[:, 0])
    bins = np.clip(((half - bearing) / (2 * half) * BINS).astype(np.int64), 0, BINS - 1)
    distance = np.hypot(points[:, 0], points[:, 1]) / config.target.max_range
    count = np.bincount(bins, minlength=BINS)
    seen = count > 0
    low, high, top = np.full(BINS, 9.0), np.zeros(BINS), np.full(BINS, -1.0)
    np.minimum.at(low, bins, distance)
    np.maximum.at(high, bins, distance)
    np.maximum.at(top, bins, points[:, 2])

    # Fill the bins seen.
    mean = np.bincount(bins, distance, BINS)[seen] / count[seen]
    lines = max(1.0, view.image.n_lines / BINS)
    result[0, seen], result[1, seen], result[2, seen] = mean, (high - low)[seen], top[seen]
    result[3, seen] = count[seen] / (lines * n)
    return _clip(result, -1.0)


def _clip(values: FloatArray, low: float) -> Values:
    """Return ``values`` clipped to ``low`` .. 1."""
    return np.asarray(np.clip(values, low, 1.0), dtype=np.float32)


def encode_pose(session: Session) -> Values:
    """Return the pose relative to the target as first seen (6,): x, y, cos, sin of the heading.

    The frame has its origin in the middle of the target and x along its first outward normal. The
    last two entries are cos and sin of the bearing of the robot from there.
    """
    view, middle = session.views[-1].T_world_scan, session.hint.mean(axis=0)
    off = np.array([view.x, view.y]) - middle

    # Position in the target's frame.
    normal = math.atan2(session.front[1], session.front[0])
    c, s = math.cos(normal), math.sin(normal)
    x, y = float(off @ (c, s)), float(off @ (-s, c))
    yaw, bearing = wrap(view.yaw - normal), math.atan2(y, x)

    # Scale to -1 .. 1.
    values = [
        x / POSITION_SCALE,
        y / POSITION_SCALE,
        math.cos(yaw),
        math.sin(yaw),
        math.cos(bearing),
        math.sin(bearing),
    ]
    return _clip(np.array(values), -1.0)


def encode_stats(context: PlanningContext) -> Values:
    """Return the robot's progress (8,), each 0..1.

    Views per ``max_views``; turn about the target, per full turn; share of lines on the target;
    whether its end is in view; fitness, predicted error and residual of the latest registration;
    whether the tour goes all the way round.
    """
    config, views, view = context.session.config, context.session.views, context.view

    # Progress around the target.
    headings = [seen.T_world_scan.yaw for seen in views]
    turned = sum(wrap(b - a) for a, b in pairwise(headings))
    lines = len(view.target.occupied_lines)

    # Quality of the latest registration.
    fit, predicted, residual = 1.0, 0.0, 0.0
    worst = ERROR_SCALE * config.planning.epsilon
    if view.registration is not None:
        fit = view.registration.fitness
        predicted = view.registration.predicted_rmse / worst
        residual = view.registration.inlier_rmse / worst

    # Scale to 0 .. 1.
    values = [
        len(views) / config.max_views,
        abs(turned) / math.tau,
        lines / view.image.n_lines,
        float(sees_target(context) and context.has_end_in_view),
        fit,
        predicted,
        residual,
        float(config.tour == "full"),
    ]
    known: FloatArray = np.nan_to_num(np.array(values), nan=1.0)
    return _clip(known, 0.0)
