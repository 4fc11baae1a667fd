"""Oracle planner, the bound for all others: the fewest views, planned on the true surface.

W. R. Scott, G. Roth and J.-F. Rivest, View planning with a registration constraint, 3DIM 2001: set
cover as an integer program in which views must overlap. Here consecutive views must overlap by at
least ``baselines.min_overlap``: they form a chain in the order of the tour, starting from the
latest view, and cover ``baselines.coverage`` of the coverable surface together with all earlier
views. Only the twin knows the truth. The regret of a planner is its number of views beyond the
oracle's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.model.coverable import (
    find_coverable_surface,
    find_feasible_places,
    find_visible,
)
from scan3d_twin.core.model.pose_errors import find_true_pose, lay_on_truth
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.planning.candidates.pose_candidates import MAX_STANDOFFS, MIN_STANDOFFS
from scan3d_twin.core.planning.context import (
    PlanningContext,
    blocked_plan,
    explain_view_limit,
    stop_plan,
)
from scan3d_twin.core.planning.overlap_or_default import predict_error
from scan3d_twin.core.planning.surface.set_cover import Cover, solve_chain_cover, solve_set_cover
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, Candidate, FloatArray, IntArray, Plan, Pose2
from scan3d_twin.core.viewpoints import MAX_FRONT_ANGLE, measure_angle

TRUTH_SPACING = 0.03
"""Spacing of the samples of the true surface [m]: a twentieth of the width of a sweep."""
MAX_POSES = 60
"""Largest number of candidates; more are thinned out evenly, as arcs grow with their square."""


class OraclePlanner:
    """The fewest overlapping views on the true surface; the bound for all others, twin only."""

    needs_truth = True

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._worlds: dict[Config, TrueWorld] = {}

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the first view of a smallest chain that completes the coverage."""
        context, config = PlanningContext(session), session.config
        if (reason := explain_view_limit(session)) is not None:
            return stop_plan(reason)

        # Stop when enough is covered
        world = self._worlds.setdefault(config, TrueWorld(self._truth, config))
        taken = [find_true_pose(view, self._truth) for view in session.views]
        seen = np.stack([world.sees(pose) for pose in taken])
        if float(np.mean(seen.any(axis=0))) >= config.baselines.coverage:
            return stop_plan(f"{config.tour} complete: {np.mean(seen.any(axis=0)):.0%} is covered")

        # Find the chain of further views
        T_map_world = lay_on_truth(session, self._truth)
        T_scan_map = session.views[-1].T_world_scan.inverse() @ T_map_world.inverse()
        free = np.array(
            [context.is_feasible(T_scan_map @ pose) for pose in world.poses], dtype=bool
        )
        chain, chained = world.rest(seen, free)
        if not context.has_panorama and not chained:
            return blocked_plan(context)
        if len(chain) == 0:
            return stop_plan("no viewpoint left: nothing that is missing can be seen")

        # Describe its first view
        pose = world.poses[chain[0]]
        overlap = float(np.mean(world.visible[chain[0]][seen[-1]])) if seen[-1].any() else 0.0
        error = predict_error(context, T_scan_map @ pose)
        viewpoint = T_map_world.inverse() @ pose
        reason = f"first of {len(chain)} more views on the true surface"
        if not chained:
            reason += ", which do not overlap enough"
        candidate = Candidate(viewpoint, overlap, error, feasible=True)
        return Plan(viewpoint, overlap, error, False, (candidate,), reason)


@dataclass(frozen=True)
class TrueWorld:
    """The true surface and the viewpoints around it, in ``map``."""

    truth: Truth
    config: Config

    @cached_property
    def _surface(self) -> tuple[FloatArray, FloatArray]:
        """Samples (n, 3) of the coverable surface and their normals (n, 3)."""
        points, normals = self.truth.surface(TRUTH_SPACING)
        kept = find_coverable_surface(points, normals, self.truth, self.config)
        return points[kept], normals[kept]

    @cached_property
    def poses(self) -> tuple[Pose2, ...]:
        """Candidates that face the nearest surface, in the order in which a tour passes them."""
        # Choose places about a standoff away
        points, _ = self._surface
        places = find_feasible_places(points, self.truth, self.config)
        standoff = self.config.planning.standoff
        distance, index = Tree.of(points[:, :2]).closest(places)
        ring = (distance >= MIN_STANDOFFS * standoff) & (distance <= MAX_STANDOFFS * standoff)

        # Face the nearest surface
        towards = points[index[ring], :2] - places[ring]
        yaws = np.arctan2(towards[:, 1], towards[:, 0])
        poses = [Pose2(x, y, yaw) for (x, y), yaw in zip(places[ring], yaws, strict=True)]

        # Order and thin them out
        poses = sorted((p for p in poses if self._is_on_tour(p)), key=self._progress)
        step = max(1.0, len(poses) / MAX_POSES)
        return tuple(poses[int(k * step)] for k in range(int(len(poses) / step)))

    def _is_on_tour(self, pose: Pose2) -> bool:
        """Return whether ``pose`` looks at the part of the target that the tour wants."""
        front = self.truth.front
        if self.config.tour != "front" or front is None:
            return True
        outward = np.array([math.cos(front.yaw), math.sin(front.yaw)])
        back = np.array([-math.cos(pose.yaw), -math.sin(pose.yaw)])
        return abs(measure_angle(outward, back)) <= MAX_FRONT_ANGLE + 1e-6

    def _progress(self, pose: Pose2) -> float:
        """Return the position of ``pose`` along the tour: to the right, or counter-clockwise."""
        front = self.truth.front
        if self.config.tour == "front" and front is not None:
            return (front.inverse() @ pose).y
        middle = self._surface[0][:, :2].mean(axis=0)
        start = math.atan2(self.truth.spawn.y - middle[1], self.truth.spawn.x - middle[0])
        return (math.atan2(pose.y - middle[1], pose.x - middle[0]) - start) % math.tau

    def sees(self, pose: Pose2) -> BoolArray:
        """Return which samples (n,) a sweep at ``pose`` sees, its margins included."""
        points, normals = self._surface
        half = self.config.sweep.width / 2 + self.config.sweep.margin
        local = pose.inverse().apply(points)
        inside = np.flatnonzero(np.abs(np.arctan2(local[:, 1], local[:, 0])) <= half)
        seen = np.zeros(len(points), dtype=bool)
        eye = np.array([pose.x, pose.y, LIDAR_HEIGHT])
        seen[inside] = find_visible(eye, points[inside], normals[inside], self.truth, self.config)
        return seen

    @cached_property
    def visible(self) -> BoolArray:
        """Which pose sees which sample (m, n)."""
        if not self.poses:
            return np.zeros((0, len(self._surface[0])), dtype=bool)
        return np.stack([self.sees(pose) for pose in self.poses])

    @cached_property
    def _follows(self) -> BoolArray:
        """Which pose sees enough of what another saw to come after it (m, m)."""
        sees = self.visible.astype(np.float64)
        shared = sees @ sees.T / np.maximum(sees.sum(axis=1), 1.0)[:, None]
        return np.asarray(shared >= self.config.baselines.min_overlap)

    def rest(self, seen: BoolArray, free: BoolArray) -> tuple[IntArray, bool]:
        """Return the fewest further poses, in order, and whether they form an overlapping chain.

        Args:
            seen: Samples that each view has seen (k, n); the robot is at the last view.
            free: Poses that are reachable by the costmap (m,).
        """
        # Measure what is missing
        already: BoolArray = np.asarray(seen.any(axis=0))
        new = self.visible & ~already
        goal = self.config.baselines.coverage * len(already) - np.count_nonzero(already)
        needed = min(goal, float(np.count_nonzero(new.any(axis=0))))
        if needed < 1.0:
            return np.zeros(0, dtype=np.int64), True

        # Look for a chain
        cover = Cover(new, np.ones(len(already)), needed, np.zeros(len(new)))
        shared = self.visible[:, seen[-1]].sum(axis=1) / max(1, int(seen[-1].sum()))
        starts = free & (shared >= self.config.baselines.min_overlap)
        chain = solve_chain_cover(cover, self._follows, starts)
        if chain is not None:
            return chain, True

        # Settle for any views
        cover = Cover(new & free[:, None], cover.weights, 0.0, cover.cost)
        cover = replace(cover, needed=min(goal, float(np.count_nonzero(cover.sees.any(axis=0)))))
        loose = solve_set_cover(cover)
        return (np.zeros(0, dtype=np.int64) if loose is None else loose), False
