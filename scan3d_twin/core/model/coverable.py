"""Which part of the true surface a robot can cover: what is visible from where it can stand."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.grids import find_connected
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

MIN_COSINE = 0.15
"""Cosine of the incidence below which (81 deg) a surface is not visible."""
POSE_STEP = 0.30
"""Spacing of the grid of poses from which surface can be covered [m]."""
CLEAR_HEIGHTS = (0.05, 0.15, 0.25, 0.33)
"""Heights at which a feasible pose must be free of obstacles [m]."""
HIT_TOLERANCE = 0.005
"""Distance from a surface point within which a ray has hit it [m]."""


def find_coverable_surface(
    surface: FloatArray, normals: FloatArray, truth: Truth, config: Config
) -> BoolArray:
    """Return which surface samples (n,) are visible, without noise, from a feasible pose.

    Visible means within the range and window of ``config.target``, not flatter than ``MIN_COSINE``
    and not hidden. Feasible means that the robot fits there and can reach it from the spawn; for
    the tour ``front`` it must also be on the front side.
    """
    places = find_feasible_places(surface, truth, config)
    # The lidar is 5 cm ahead of the axle, which is neglected here
    eyes = np.column_stack([places, np.full(len(places), LIDAR_HEIGHT)])
    unseen = np.flatnonzero(_find_faced(surface, normals, eyes))
    seen = np.zeros(len(surface), dtype=bool)
    for eye in eyes:
        now = unseen[find_visible(eye, surface[unseen], normals[unseen], truth, config)]
        seen[now] = True
        unseen = unseen[~seen[unseen]]
    return seen


def _find_faced(surface: FloatArray, normals: FloatArray, eyes: FloatArray) -> BoolArray:
    """Return which samples (n,) face at least one of ``eyes`` (m, 3), even if hidden from it."""
    if len(eyes) == 0:
        return np.zeros(len(surface), dtype=bool)
    farthest = np.max(normals @ eyes[_find_row_ends(eyes)].T, axis=1)
    return np.asarray(farthest > np.einsum("ij,ij->i", normals, surface))


def _find_row_ends(eyes: FloatArray) -> IntArray:
    """Return the indices of the first and last of ``eyes`` (n, 3) of the same x, by their y.

    All corners of their convex hull are among them.
    """
    order = np.lexsort((eyes[:, 1], eyes[:, 0]))
    first = np.flatnonzero(np.diff(eyes[order, 0], prepend=-np.inf))
    last = np.append(first[1:], len(eyes)) - 1
    return np.unique(order[np.concatenate([first, last])])


def find_visible(
    eye: FloatArray, surface: FloatArray, normals: FloatArray, truth: Truth, config: Config
) -> BoolArray:
    """Return which samples (n,) the lidar sees from ``eye`` (3,)."""
    # Check range, window and incidence
    rays = surface - eye
    distance = np.linalg.norm(rays, axis=1)
    slope = np.tan(config.target.window / 2)
    seen = distance <= config.target.max_range
    seen &= np.abs(rays[:, 2]) <= slope * np.hypot(rays[:, 0], rays[:, 1])
    seen &= -np.einsum("ij,ij->i", rays, normals) > MIN_COSINE * distance

    # Cast rays at the rest
    index = np.flatnonzero(seen)
    if len(index):
        directions = rays[index] / distance[index, None]
        hits = truth.first_opaque_hits(np.broadcast_to(eye, (len(index), 3)), directions)
        seen[index] = hits >= distance[index] - HIT_TOLERANCE
    return np.asarray(seen)


def find_feasible_places(surface: FloatArray, truth: Truth, config: Config) -> FloatArray:
    """Return the places of a grid (n, 2) [m] where the robot fits and which it can reach."""
    # Lay a grid around the target, and the spawn
    start = np.array([truth.spawn.x, truth.spawn.y])
    low = np.minimum(surface[:, :2].min(axis=0) - config.target.max_range, start)
    high = np.maximum(surface[:, :2].max(axis=0) + config.target.max_range, start + POSE_STEP)
    first = np.floor((low - start) / POSE_STEP).astype(np.int64)
    last = np.ceil((high - start) / POSE_STEP).astype(np.int64)
    i, j = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]), indexing="ij")
    places = start + np.stack([i, j], axis=-1) * POSE_STEP

    # Keep what is connected with the spawn
    free = _is_free(places.reshape(-1, 2), truth, config).reshape(i.shape)
    spawn = (-int(first[0]), -int(first[1]))
    reachable = find_connected(free, spawn) if free[spawn] else np.zeros_like(free)
    if config.tour == "front" and truth.front is not None:
        reachable &= truth.front.inverse().apply(places)[..., 0] > 0
    return np.asarray(places[reachable])


def _is_free(places: FloatArray, truth: Truth, config: Config) -> BoolArray:
    """Return at which places (n,) nothing is within the robot's radius and the floor is below."""
    # Cast rays all round
    angles = np.linspace(-np.pi, np.pi, 36, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    free = np.ones(len(places), dtype=bool)
    for height in CLEAR_HEIGHTS:
        centres = np.column_stack([places, np.full(len(places), height)])
        origins, directions = np.repeat(centres, len(ring), axis=0), np.tile(ring, (len(places), 1))
        hits = truth.first_hits(origins, directions).reshape(len(places), len(ring))
        free &= hits.min(axis=1) > config.motion.robot_radius

    # Cast rays down
    down = np.broadcast_to((0.0, 0.0, -1.0), (len(places), 3))
    floor = truth.first_hits(np.column_stack([places, np.full(len(places), LIDAR_HEIGHT)]), down)
    return np.asarray(free & (np.abs(floor - LIDAR_HEIGHT) < config.target.floor_height))
