"""Viewpoints that could be next, for planners that choose a pose and not an overlap.

A grid of places around the target from which the robot can look at it, each with three headings;
the way to each from the one search of the costmap; and what a sweep there would show anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.planning.context import MIN_LINES, PlanningContext, finish
from scan3d_twin.core.planning.overlap_search import predict_error
from scan3d_twin.core.planning.surface_patches import (
    Eye,
    Patches,
    overlap_of,
    seen_patches,
    view_patches,
)
from scan3d_twin.core.planning.voxels import OCCUPIED, VOXEL, Rays, VoxelMap, voxel_map
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, FloatArray, Plan, Pose2, wrap
from scan3d_twin.core.viewpoints import FRONT_SIDE, angle_between

NEAR, FAR = 0.7, 1.3
"""Distances from the target, in standoffs, between which a place is a candidate; those that the
paper's planner may choose too where the wanted place is blocked."""
HEADINGS = tuple(math.radians(angle) for angle in (0.0, 25.0, -25.0))
"""Off the nearest point of the target; 25 deg keep it in a sweep of 60 deg."""
SAME_PLACE, SAME_HEADING = 0.15, math.radians(15.0)
"""A candidate this near to an earlier view shows nothing new [m], [rad]; an assumption."""
KEPT = 10
"""Runners-up that a plan names."""


@dataclass(frozen=True)
class PoseCandidates:
    """All candidates for the next viewpoint; arrays are in their order."""

    context: PlanningContext

    @staticmethod
    def of(session: Session) -> PoseCandidates:
        """Return the candidates after the latest view of ``session``."""
        return PoseCandidates(PlanningContext(session))

    @property
    def session(self) -> Session:
        """The session so far."""
        return self.context.session

    @cached_property
    def eye(self) -> Eye:
        """What a sweep sees."""
        return Eye.of(self.session.views[-1], self.session.config)

    @cached_property
    def surface(self) -> Patches:
        """The target's surface as far as it was seen, in ``world``."""
        return seen_patches(self.session)

    @cached_property
    def space(self) -> VoxelMap:
        """The space around it."""
        return voxel_map(self.session, self.session.config.planning.standoff)

    @cached_property
    def _here(self) -> Pose2:
        return self.session.views[-1].T_world_scan

    @cached_property
    def _offered(self) -> tuple[tuple[Pose2, ...], FloatArray]:
        """Poses in ``world`` and the ways there [m] (m,)."""
        places, towards = _ring(self.surface.points[:, :2], self.session)
        ways = self.ways(places)
        poses, lengths = [], []
        for place, heading, way in zip(places, towards, ways, strict=True):
            if not np.isfinite(way):
                continue
            for turn in HEADINGS:
                pose = Pose2(float(place[0]), float(place[1]), heading + turn)
                if self.allowed(pose):
                    poses.append(pose)
                    lengths.append(way)
        return tuple(poses), np.array(lengths)

    @property
    def poses(self) -> tuple[Pose2, ...]:
        """The feasible candidates ``T_world_scan``, in a fixed order."""
        return self._offered[0]

    @property
    def travel(self) -> FloatArray:
        """Length of the way to each (m,) [m]."""
        return self._offered[1]

    @cached_property
    def turns(self) -> FloatArray:
        """Turn from the present heading to each (m,) [rad]."""
        return np.array([abs(wrap(pose.yaw - self._here.yaw)) for pose in self.poses])

    def ways(self, places: FloatArray) -> FloatArray:
        """Return the length of the way (n,) [m] to ``places`` (n, 2) in ``world``; inf for none."""
        T_odom_world = self.session.views[-1].observation.T_odom_scan @ self._here.inverse()
        return self.context.costmap.ways(T_odom_world.apply(places))

    def allowed(self, pose: Pose2) -> bool:
        """Tell whether ``pose`` belongs to the tour and was not taken yet."""
        if self.session.config.tour == "front":
            back = np.array([-math.cos(pose.yaw), -math.sin(pose.yaw)])
            if abs(angle_between(self.session.front, back)) > FRONT_SIDE + 1e-6:
                return False
        return not any(
            pose.distance(view.T_world_scan) < SAME_PLACE
            and abs(wrap(pose.yaw - view.T_world_scan.yaw)) < SAME_HEADING
            for view in self.session.views
        )

    @cached_property
    def rays(self) -> tuple[Rays, ...]:
        """What a sweep at each candidate would meet."""
        reach = 2 * self.session.config.planning.standoff
        return tuple(self.space.march(pose, self.eye, reach) for pose in self.poses)

    @cached_property
    def new_area(self) -> FloatArray:
        """Area (m,) [m2] of the unknown at the target's border that each would see."""
        more = self.space.may_hold_more
        return np.array([rays.met(more) * VOXEL**2 for rays in self.rays])

    @cached_property
    def worthwhile(self) -> tuple[int, ...]:
        """The candidates that see enough new area."""
        least = self.session.config.baselines.min_new_area
        return tuple(int(i) for i in np.flatnonzero(self.new_area >= least))

    def termination_reason(self) -> str | None:
        """Return why no further view can be planned, whatever the planner; None if it can."""
        views, config = self.session.views, self.session.config
        if len(views[-1].target.occupied_lines) < MIN_LINES or len(self.surface) == 0:
            return "target lost: the latest view shows nothing of it"
        if len(views) >= config.max_views:
            return f"max_views: {len(views)} views taken"
        return None

    def nothing_new(self) -> Plan:
        """Return the plan for when no candidate is worthwhile: look around first, then finish."""
        if self.context.looked:
            return finish(f"{self.session.config.tour} complete: nothing new in sight")
        reason = "nothing new in sight from where the floor is known to be free: look around"
        return Plan(None, 0.0, math.nan, False, (), reason, needs_panorama=True)

    def go(self, pose: Pose2, reason: str, others: tuple[Pose2, ...] = ()) -> Plan:
        """Return the plan to go to ``pose``, with the runners-up ``others``, best first."""
        chosen = self.candidate(pose, predict_error(self.context, self._here.inverse() @ pose))
        rest = tuple(self.candidate(other, math.nan) for other in others[:KEPT])
        return Plan(
            pose, chosen.overlap, chosen.predicted_rmse, False, (*rest[::-1], chosen), reason
        )

    def best(self, values: FloatArray, reason: str) -> Plan:
        """Return the plan for the candidate of the largest of ``values`` (m,)."""
        order = np.argsort(-values, kind="stable")
        order = order[np.isfinite(values[order])]
        poses = tuple(self.poses[i] for i in order)
        return self.go(poses[0], reason, poses[1:])

    def candidate(self, pose: Pose2, error: float) -> Candidate:
        """Return ``pose`` with the share of the latest view's surface that it would see again."""
        again = self.eye.sees(pose, self._latest, occluders=self.hiding)
        return Candidate(pose, overlap_of(self._latest, again), error, feasible=True)

    @cached_property
    def _latest(self) -> Patches:
        view = self.session.views[-1]
        return view_patches(view).moved(view.T_world_scan)

    @cached_property
    def hiding(self) -> FloatArray:
        """All that is known to stand about, the middles of the occupied voxels (n, 3)."""
        cells = np.argwhere(self.space.labels == OCCUPIED)
        return np.asarray(self.space.origin + (cells + 0.5) * VOXEL)


def _ring(target: FloatArray, session: Session) -> tuple[FloatArray, FloatArray]:
    """Return grid places (n, 2) about a standoff from ``target`` (k, 2), and the way to face it."""
    standoff, step = session.config.planning.standoff, session.config.baselines.grid_step
    low, high = target.min(axis=0) - FAR * standoff, target.max(axis=0) + FAR * standoff
    axes = [
        np.arange(np.floor(a / step), np.ceil(b / step) + 1) for a, b in zip(low, high, strict=True)
    ]
    places = step * np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    distance, index = nearest(cKDTree(target), places)
    ring = (distance >= NEAR * standoff) & (distance <= FAR * standoff)
    to = target[index[ring]] - places[ring]
    return places[ring], np.arctan2(to[:, 1], to[:, 0])
