"""The Surface Edge Explorer, restricted to a robot on the floor.

R. Border and J. D. Gammell, The Surface Edge Explorer (SEE): a measurement-direct approach to next
best view planning, IJRR 43(10), 2024. No map of the space: a point of the cloud with at least k
neighbours within r is core, one with less that has both core and other neighbours is a frontier of
the surface. Each frontier point proposes a view at distance d along its normal; a hidden one turns
until it is not. Of the proposal nearest to the robot and those that see its frontier too, the one
that sees the most frontiers for the travel is taken. A frontier that survives a view is looked at
from farther round its edge, and is given up after some views.

Restricted to x, y and yaw: normals are laid flat, a hidden view turns about the vertical alone, and
frontiers that only a higher or lower lidar could move are dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.model.fused_cloud import voxel_thin
from scan3d_twin.core.planning.context import finish
from scan3d_twin.core.planning.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.surface_patches import Patches, eye_height
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, FloatArray, Plan, Pose2

SPACING = 0.02
"""No two points of the cloud are nearer (SEE's epsilon) [m]: twice the range noise."""
RADIUS = 0.06
"""SEE's r [m]: three spacings."""
DENSITY = 1.3e4
"""SEE's rho [1/m3]: with r it asks for 12 neighbours; a plane with the spacing has about 20, its
border half of them."""
CELL = 0.10
"""One frontier point stands for those in its cell [m]."""
UPRIGHT = math.cos(math.radians(45.0))
"""A frontier that goes up or down more steeply is out of the robot's hands."""
TURNS = tuple(math.radians(s * a) for a in (0, 15, 30, 45, 60) for s in ((1, -1) if a else (1,)))
"""Turns of a hidden or blocked view about the frontier [rad]."""
ADJUST, PATIENCE = math.radians(30.0), 2
"""A surviving frontier is looked at from so much farther round for each view, until given up."""


class SeePlanner:
    """Surface Edge Explorer: the view of the nearest frontier of the cloud's density."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the proposal that sees the most frontiers on the way to the nearest one."""
        candidates = PoseCandidates.of(session)
        if reason := candidates.termination_reason():
            return finish(reason)
        frontier = frontier_points(session)
        frontier, seen = _not_given_up(frontier, candidates)
        proposals = [
            _proposal(frontier.at(i), int(seen[i]), candidates) for i in range(len(frontier))
        ]
        kept = np.array([i for i, pose in enumerate(proposals) if pose is not None], dtype=int)
        if len(kept) == 0:
            return candidates.nothing_new()
        poses = [pose for pose in proposals if pose is not None]
        return _select(poses, frontier.patches.select(kept), candidates)


@dataclass(frozen=True)
class Frontier:
    """Points where the surface's density ends.

    Attributes:
        patches: Their places and normals, in ``world``.
        onwards: Unit tangents (n, 3) from the surface into the unseen.
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


def frontier_points(session: Session) -> Frontier:
    """Return the frontier of all that was seen of the target, one point in each cell."""
    clouds = [view.T_world_scan.apply(view.target.points) for view in session.views]
    cloud = _spaced(voxel_thin(np.concatenate(clouds), SPACING / 2))
    neighbours: Any = cKDTree(cloud).query_ball_point(cloud, RADIUS)
    least = DENSITY * 4 / 3 * math.pi * RADIUS**3
    core = np.array([len(near) - 1 >= least for near in neighbours])
    edge = [
        i
        for i, near in enumerate(neighbours)
        if not core[i] and core[near].any() and np.count_nonzero(~core[near]) > 1
    ]
    edge = _one_each(cloud, edge)
    eyes = np.array([[v.T_world_scan.x, v.T_world_scan.y, eye_height(v)] for v in session.views])
    rows = [_geometry(cloud[i], cloud[neighbours[i]], eyes) for i in edge]
    points, normals, onwards = (np.array([row[k] for row in rows]).reshape(-1, 3) for k in range(3))
    frontier = Frontier(Patches(points, normals, np.zeros(len(points))), onwards)
    return frontier.select(np.abs(onwards[:, 2]) <= UPRIGHT)


def _spaced(points: FloatArray) -> FloatArray:
    """Return those ``points`` (n, 3) that have none of the earlier ones kept within ``SPACING``."""
    kept = np.ones(len(points), dtype=bool)
    around: Any = cKDTree(points).query_ball_point(points, SPACING)
    for i, near in enumerate(around):
        if kept[i]:
            kept[[j for j in near if j > i]] = False
    return points[kept]


def _one_each(cloud: FloatArray, edge: list[int]) -> list[int]:
    """Return one point of each cell."""
    cells = np.floor(cloud[edge] / CELL).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return [edge[i] for i in np.sort(first)]


def _geometry(
    point: FloatArray, near: FloatArray, eyes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a frontier point, its normal towards the nearest eye, and the way onwards."""
    offset = near - near.mean(axis=0)
    normal = np.linalg.eigh(offset.T @ offset)[1][:, 0]
    eye = eyes[np.argmin(np.linalg.norm(eyes - point, axis=1))]
    normal = normal if normal @ (eye - point) > 0 else -normal
    onwards = point - near.mean(axis=0)
    onwards = onwards - (onwards @ normal) * normal
    return point, normal, onwards / max(float(np.linalg.norm(onwards)), 1e-12)


def _not_given_up(frontier: Frontier, candidates: PoseCandidates) -> tuple[Frontier, FloatArray]:
    """Return the frontier that is still worth a view, and how many views saw each point (n,)."""
    seen = np.zeros(len(frontier))
    for view in candidates.session.views:
        seen += candidates.eye.sees(view.T_world_scan, frontier.patches)
    kept = seen <= PATIENCE
    return frontier.select(kept), seen[kept]


def _proposal(point: Frontier, seen: int, candidates: PoseCandidates) -> Pose2 | None:
    """Return the feasible view of a frontier point nearest to its normal; None if there is none."""
    normal, onwards = point.patches.normals[0, :2], point.onwards[0, :2]
    if np.linalg.norm(normal) < 1e-6:
        return None
    side = math.copysign(1.0, float(normal[0] * onwards[1] - normal[1] * onwards[0]))
    adjusted = side * ADJUST * max(0, seen - 1)
    distance = candidates.session.config.planning.standoff
    bearing = math.atan2(normal[1], normal[0]) + adjusted
    places = np.array(
        [
            point.patches.points[0, :2]
            + distance * np.array([math.cos(bearing + turn), math.sin(bearing + turn)])
            for turn in TURNS
        ]
    )
    ways = candidates.ways(places)
    for place, turn, way in zip(places, TURNS, ways, strict=True):
        pose = Pose2(float(place[0]), float(place[1]), bearing + turn + math.pi)
        if np.isfinite(way) and candidates.allowed(pose) and _in_sight(pose, point, candidates):
            return pose
    return None


def _in_sight(pose: Pose2, point: Frontier, candidates: PoseCandidates) -> bool:
    """Tell whether nothing that is known hides the point; an adjusted view looks along it."""
    patches = point.patches
    towards = np.array([[pose.x, pose.y, candidates.eye.height]]) - patches.points
    facing = Patches(patches.points, towards, patches.variation)
    return bool(candidates.eye.sees(pose, facing, occluders=candidates.hiding)[0])


def _select(poses: list[Pose2], frontier: Patches, candidates: PoseCandidates) -> Plan:
    """Return the plan by the frontier-visibility graph: arcs from views to frontiers they see."""
    places = np.array([[pose.x, pose.y] for pose in poses])
    travel = np.maximum(candidates.ways(places), 1e-3)
    arcs = np.stack([candidates.eye.sees(pose, frontier, candidates.hiding) for pose in poses])
    np.fill_diagonal(arcs, val=True)
    degree = arcs.sum(axis=1)
    nearest = int(np.argmin(travel))
    better = np.flatnonzero(arcs[:, nearest] & (degree > degree[nearest]))
    chosen = nearest
    if len(better):
        chosen = int(better[np.argmax(degree[better] / travel[better])])
    order = [i for i in np.argsort(travel, kind="stable") if i != chosen]
    reason = f"sees {degree[chosen]} of {len(poses)} frontier points, the nearest among them"
    return candidates.go(poses[chosen], reason, tuple(poses[i] for i in order))
