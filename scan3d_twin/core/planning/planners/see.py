"""The Surface Edge Explorer, restricted to a robot on the floor.

R. Border and J. D. Gammell, The Surface Edge Explorer (SEE): a measurement-direct approach to next
best view planning, IJRR 43(10), 2024. The method has no map of the space: a point of the cloud with
at least k neighbours within r is core, and a point with fewer that has both core and other
neighbours is a frontier of the surface. Each frontier point proposes a view at distance d along its
normal; a view that is hidden is rotated until it is not. Among the proposal nearest to the robot
and those that see its frontier, too, the one that sees the most frontiers for the travel is chosen.
A frontier that survives a view is seen from farther around its edge next time, and given up after a
number of views.

Restricted to x, y and yaw, normals are projected on the floor, a hidden view rotates about the
vertical only, and frontiers that only a higher or lower lidar could see are dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.model.fused_cloud import thin_by_voxel
from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import stop_plan
from scan3d_twin.core.planning.surface.surface_patches import Patches, lidar_height
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, FloatArray, Plan, Pose2

POINT_SPACING = 0.02
"""Smallest distance of two points of the cloud, SEE's epsilon [m]: twice the range noise."""
NEIGHBOUR_RADIUS = 0.06
"""Radius of a point's neighbourhood, SEE's r [m]: three spacings."""
CORE_DENSITY = 1.3e4
"""Density of a core point's neighbourhood, SEE's rho [1/m3]: with r it requires 12 neighbours; a
plane with that spacing has about 20, its border half of them."""
FRONTIER_CELL = 0.10
"""Side of a cell in which one frontier point represents the others [m]."""
MAX_STEEPNESS = math.cos(math.radians(45.0))
"""Vertical component of a frontier's direction above which the robot cannot follow it."""
TURNS = tuple(math.radians(s * a) for a in (0, 15, 30, 45, 60) for s in ((1, -1) if a else (1,)))
"""Rotations of a hidden or blocked view about the frontier [rad]."""
ADJUSTMENT, MAX_SIGHTINGS = math.radians(30.0), 2
"""Rotation about a surviving frontier for each further view [rad], and number of views after which
it is given up."""


class SeePlanner:
    """Surface Edge Explorer: the view of the nearest frontier of the cloud's density."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the plan for the proposal that sees the most frontiers near the nearest one."""
        candidates = PoseCandidates.of(session)
        if reason := candidates.termination_reason():
            return stop_plan(reason)

        # Propose a view of each frontier
        frontier = find_frontier(session)
        frontier, seen = _drop_given_up(frontier, candidates)
        proposals = [
            _propose_view(frontier.at(i), int(seen[i]), candidates) for i in range(len(frontier))
        ]

        # Choose among the feasible ones
        kept = np.array([i for i, pose in enumerate(proposals) if pose is not None], dtype=int)
        if len(kept) == 0:
            return candidates.nothing_new()
        poses = [pose for pose in proposals if pose is not None]
        return _choose_plan(poses, frontier.patches.select(kept), candidates)


@dataclass(frozen=True)
class Frontier:
    """Points at which the density of the surface ends.

    Attributes:
        patches: Their places and normals, in ``world``.
        onwards: Unit tangents from the surface into the unseen (n, 3).
    """

    patches: Patches
    onwards: FloatArray

    def __len__(self) -> int:
        return len(self.patches)

    def at(self, i: int) -> Frontier:
        """Return the ``i``-th point alone."""
        return self.select(np.arange(len(self)) == i)

    def select(self, mask: BoolArray) -> Frontier:
        """Return the points where ``mask`` (n,) is True."""
        return Frontier(self.patches.select(mask), self.onwards[mask])


def find_frontier(session: Session) -> Frontier:
    """Return the frontier of the target's cloud of all views, one point in each cell."""
    # Thin the cloud
    clouds = [view.T_world_scan.apply(view.target.points) for view in session.views]
    cloud = _space_out(thin_by_voxel(np.concatenate(clouds), POINT_SPACING / 2))

    # Find points at the core's edge
    neighbours: Any = cKDTree(cloud).query_ball_point(cloud, NEIGHBOUR_RADIUS)
    least = CORE_DENSITY * 4 / 3 * math.pi * NEIGHBOUR_RADIUS**3
    core = np.array([len(near) - 1 >= least for near in neighbours])
    edge = [
        i
        for i, near in enumerate(neighbours)
        if not core[i] and core[near].any() and np.count_nonzero(~core[near]) > 1
    ]
    edge = _choose_one_per_cell(cloud, edge)

    # Fit normals and tangents
    eyes = np.array([[v.T_world_scan.x, v.T_world_scan.y, lidar_height(v)] for v in session.views])
    rows = [_fit_frontier(cloud[i], cloud[neighbours[i]], eyes) for i in edge]
    points, normals, onwards = (np.array([row[k] for row in rows]).reshape(-1, 3) for k in range(3))
    frontier = Frontier(Patches(points, normals, np.zeros(len(points))), onwards)
    return frontier.select(np.abs(onwards[:, 2]) <= MAX_STEEPNESS)


def _space_out(points: FloatArray) -> FloatArray:
    """Return the points (k, 3) of which no earlier one that is kept is within ``POINT_SPACING``."""
    kept = np.ones(len(points), dtype=bool)
    around: Any = cKDTree(points).query_ball_point(points, POINT_SPACING)
    for i, near in enumerate(around):
        if kept[i]:
            kept[[j for j in near if j > i]] = False
    return points[kept]


def _choose_one_per_cell(cloud: FloatArray, edge: list[int]) -> list[int]:
    """Return the indices of ``edge`` thinned to the first in each ``FRONTIER_CELL``."""
    cells = np.floor(cloud[edge] / FRONTIER_CELL).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return [edge[i] for i in np.sort(first)]


def _fit_frontier(
    point: FloatArray, near: FloatArray, eyes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a frontier point, its normal towards the nearest eye, and its tangent onwards."""
    offset = near - near.mean(axis=0)
    normal = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    eye = eyes[np.argmin(np.linalg.norm(eyes - point, axis=1))]
    normal = normal if normal @ (eye - point) > 0 else -normal
    onwards = point - near.mean(axis=0)
    onwards = onwards - (onwards @ normal) * normal
    return point, normal, onwards / max(float(np.linalg.norm(onwards)), 1e-12)


def _drop_given_up(frontier: Frontier, candidates: PoseCandidates) -> tuple[Frontier, FloatArray]:
    """Return the frontier that is still worth a view, and the number of views of each point."""
    seen = np.zeros(len(frontier))
    for view in candidates.session.views:
        seen += candidates.eye.sees(view.T_world_scan, frontier.patches)
    kept = seen <= MAX_SIGHTINGS
    return frontier.select(kept), seen[kept]


def _propose_view(point: Frontier, seen: int, candidates: PoseCandidates) -> Pose2 | None:
    """Return the feasible view of a frontier point nearest to its normal; None if there is none."""
    # Rotate off the normal where seen before
    normal, onwards = point.patches.normals[0, :2], point.onwards[0, :2]
    if np.linalg.norm(normal) < 1e-6:
        return None
    side = math.copysign(1.0, float(normal[0] * onwards[1] - normal[1] * onwards[0]))
    adjusted = side * ADJUSTMENT * max(0, seen - 1)

    # Lay views around the frontier
    distance = candidates.session.config.planning.standoff
    bearing = math.atan2(normal[1], normal[0]) + adjusted
    places = np.array(
        [
            point.patches.points[0, :2]
            + distance * np.array([math.cos(bearing + turn), math.sin(bearing + turn)])
            for turn in TURNS
        ]
    )

    # Take the first that is feasible
    paths = candidates.path_lengths(places)
    for place, turn, path in zip(places, TURNS, paths, strict=True):
        pose = Pose2(float(place[0]), float(place[1]), bearing + turn + math.pi)
        if (
            np.isfinite(path)
            and candidates.is_allowed(pose)
            and _is_in_sight(pose, point, candidates)
        ):
            return pose
    return None


def _is_in_sight(pose: Pose2, point: Frontier, candidates: PoseCandidates) -> bool:
    """Return whether nothing known hides the point; an adjusted view may look along its surface."""
    patches = point.patches
    towards = np.array([[pose.x, pose.y, candidates.eye.height]]) - patches.points
    facing = Patches(patches.points, towards, patches.variation)
    return bool(candidates.eye.sees(pose, facing, occluders=candidates.hiding)[0])


def _choose_plan(poses: list[Pose2], frontier: Patches, candidates: PoseCandidates) -> Plan:
    """Return the plan by the frontier-visibility graph: arcs from views to frontiers they see."""
    # Link views and frontiers
    places = np.array([[pose.x, pose.y] for pose in poses])
    travel = np.maximum(candidates.path_lengths(places), 1e-3)
    arcs = np.stack([candidates.eye.sees(pose, frontier, candidates.hiding) for pose in poses])
    np.fill_diagonal(arcs, val=True)
    degree = arcs.sum(axis=1)

    # Improve on the nearest view
    nearest = int(np.argmin(travel))
    better = np.flatnonzero(arcs[:, nearest] & (degree > degree[nearest]))
    chosen = nearest
    if len(better):
        chosen = int(better[np.argmax(degree[better] / travel[better])])

    # List the others by travel
    order = [i for i in np.argsort(travel, kind="stable") if i != chosen]
    reason = f"sees {degree[chosen]} of {len(poses)} frontier points, the nearest among them"
    return candidates.go(poses[chosen], reason, tuple(poses[i] for i in order))
