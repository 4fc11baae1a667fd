"""What an agent sees: only what the robot knows. Bounded arrays in a flat dictionary.

No argument here holds the truth: the session, the costmap and the context are the robot's own.
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
"""Cells of the top view: 4.8 m, the robot in the middle, its heading up."""
LINES, BEAMS = 64, 96
"""Size of the range image that is shown."""
BINS = 64
"""Bearings of the profile, left to right across a sweep."""
FAR = 5.0
"""Positions are shown in units of this [m], and clipped."""
LOST = "target lost"
"""How a context's reason begins that has no target in it."""
WORST = 5.0
"""Errors are shown in units of this times epsilon, and clipped."""
Image = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]


def observation_space() -> dict[str, spaces.Space[Any]]:
    """Return the spaces that all environments share."""
    return {
        "topdown": spaces.Box(0, 255, (4, SIDE, SIDE), np.uint8),
        "range": spaces.Box(0, 255, (1, LINES, BEAMS), np.uint8),
        "profile": spaces.Box(-1.0, 1.0, (4 * BINS,), np.float32),
        "pose": spaces.Box(-1.0, 1.0, (6,), np.float32),
        "stats": spaces.Box(0.0, 1.0, (8,), np.float32),
    }


def observe(context: PlanningContext) -> dict[str, Any]:
    """Return the values of ``observation_space`` after the latest view."""
    session, view = context.session, context.view
    return {
        "topdown": topdown(session, context.costmap),
        "range": range_image(view, session.config.target.max_range),
        "profile": profile(view, session).ravel(),
        "pose": pose(session),
        "stats": stats(context),
    }


def sees_target(context: PlanningContext) -> bool:
    """Tell whether the latest view shows enough of the target to go on from."""
    return not (context.termination_reason() or "").startswith(LOST)


def topdown(session: Session, costmap: Costmap) -> Image:
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
    """Tell where the target is known to be (SIDE, SIDE)."""
    back = session.views[-1].T_world_scan.inverse()
    parts = [view.T_world_scan.apply(view.target.points[:, :2]) for view in session.views]
    local = back.apply(np.concatenate([session.hint, *parts]))
    i, j = np.floor(SIDE / 2 - np.ascontiguousarray(local.T) / RESOLUTION).astype(np.int64)
    inside = (i >= 0) & (i < SIDE) & (j >= 0) & (j < SIDE)
    shown = np.zeros((SIDE, SIDE), dtype=bool)
    shown[i[inside], j[inside]] = True
    return shown


def range_image(view: View, most: float) -> Image:
    """Return the ranges (1, LINES, BEAMS): 0 for no return, 1 to 255 for 0 to ``most`` [m].

    Lines left to right, beams bottom to top; every n-th of the sweep's.
    """
    ranges = view.observation.image.ranges
    rows = np.linspace(0, ranges.shape[0] - 1, LINES).astype(np.int64)
    columns = np.linspace(0, ranges.shape[1] - 1, BEAMS).astype(np.int64)
    shown = ranges[np.ix_(rows, columns)]
    grey = 1 + 254 * np.clip(np.nan_to_num(shown, nan=0.0) / most, 0.0, 1.0)
    return np.where(np.isfinite(shown), grey, 0.0).astype(np.uint8)[None]


def profile(view: View, session: Session) -> Values:
    """Return the target by bearing, left to right across the sweep (4, BINS).

    Its mean distance, its depth (both in units of the range), the top of it (in m, clipped) and
    the share of the window's beams that it fills; -1 where it is not seen, 0 for the share.
    """
    config = session.config
    half = config.sweep.width / 2 + config.sweep.margin
    points, n = view.target.points, view.image.spec.n_beams
    result = np.full((4, BINS), -1.0)
    result[3] = 0.0
    if len(points) == 0:
        return _shown(result, -1.0)
    bearing = np.arctan2(points[:, 1], points[:, 0])
    bins = np.clip(((half - bearing) / (2 * half) * BINS).astype(np.int64), 0, BINS - 1)
    distance = np.hypot(points[:, 0], points[:, 1]) / config.target.max_range
    count = np.bincount(bins, minlength=BINS)
    seen = count > 0
    low, high, top = np.full(BINS, 9.0), np.zeros(BINS), np.full(BINS, -1.0)
    np.minimum.at(low, bins, distance)
    np.maximum.at(high, bins, distance)
    np.maximum.at(top, bins, points[:, 2])
    mean = np.bincount(bins, distance, BINS)[seen] / count[seen]
    lines = max(1.0, view.image.n_lines / BINS)
    result[0, seen], result[1, seen], result[2, seen] = mean, (high - low)[seen], top[seen]
    result[3, seen] = count[seen] / (lines * n)
    return _shown(result, -1.0)


def _shown(values: FloatArray, low: float) -> Values:
    """Return ``values`` clipped to ``low`` .. 1."""
    return np.asarray(np.clip(values, low, 1.0), dtype=np.float32)


def pose(session: Session) -> Values:
    """Return the pose relative to the target as first seen (6,): x, y, cos, sin of the heading.

    Frame: the middle of the target, x along its first outward normal. Then cos and sin of the
    bearing from which the robot looks at it.
    """
    view, middle = session.views[-1].T_world_scan, session.hint.mean(axis=0)
    off = np.array([view.x, view.y]) - middle
    normal = math.atan2(session.front[1], session.front[0])
    c, s = math.cos(normal), math.sin(normal)
    x, y = float(off @ (c, s)), float(off @ (-s, c))
    yaw, bearing = wrap(view.yaw - normal), math.atan2(y, x)
    values = [x / FAR, y / FAR, math.cos(yaw), math.sin(yaw), math.cos(bearing), math.sin(bearing)]
    return _shown(np.array(values), -1.0)


def stats(context: PlanningContext) -> Values:
    """Return what the robot knows of its progress (8,), each 0..1.

    Views of the most allowed; turn about the target, of a full one; lines on the target; whether it
    ends in view; of the latest registration fitness, predicted error and residual; tour all round.
    """
    config, views, view = context.session.config, context.session.views, context.view
    headings = [seen.T_world_scan.yaw for seen in views]
    turned = sum(wrap(b - a) for a, b in pairwise(headings))
    lines = len(view.target.occupied_lines)
    fit, predicted, residual = 1.0, 0.0, 0.0
    worst = WORST * config.planning.epsilon
    if view.registration is not None:
        fit = view.registration.fitness
        predicted = view.registration.predicted_rmse / worst
        residual = view.registration.inlier_rmse / worst
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
    return _shown(known, 0.0)
