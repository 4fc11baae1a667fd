"""Candidate viewpoints for planners that choose a pose, not an overlap.

The candidates are a grid of places around the target that face it, each with three headings. The
lengths of the paths to all of them are from one search of the costmap, and rays through the voxel
map measure what a sweep from there would show anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.planning.context import (
    MIN_TARGET_LINES,
    PlanningContext,
    explain_view_limit,
    stop_plan,
)
from scan3d_twin.core.planning.overlap_or_default import predict_error
from scan3d_twin.core.planning.surface.surface_patches import (
    Eye,
    Patches,
    extract_view_patches,
    measure_overlap,
    merge_patches,
)
from scan3d_twin.core.planning.surface.voxels import (
    VOXEL_SIZE,
    Rays,
    VoxelMap,
    build_voxel_map,
    find_occupied_voxels,
)
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, FloatArray, Plan, Pose2, wrap
from scan3d_twin.core.viewpoints import MAX_FRONT_ANGLE, measure_angle

MIN_STANDOFFS, MAX_STANDOFFS = 0.7, 1.3
"""Smallest and largest distance of a candidate from the target, in standoffs; the paper's planner
has a similar choice where the wanted place is blocked."""
HEADING_OFFSETS = tuple(math.radians(angle) for angle in (0.0, 25.0, -25.0))
"""Headings relative to the nearest point of the target [rad]; 25 deg keep it in a sweep of 60
deg."""
SAME_POSE_DISTANCE, SAME_POSE_ANGLE = 0.15, math.radians(15.0)
"""Distance [m] and angle [rad] from an earlier view within which a candidate shows nothing new; an
assumption."""
MAX_RUNNERS_UP = 10
"""Number of runners-up that a plan lists."""


@dataclass(frozen=True)
class PoseCandidates:
    """All candidates for the next viewpoint; arrays follow their order."""

    context: PlanningContext

    @staticmethod
    def of(session: Session) -> PoseCandidates:
        """Return the candidates after the latest view of ``session``."""
        return PoseCandidates(PlanningContext(session))

    @property
    def session(self) -> Session:
        """The session of the context."""
        return self.context.session

    @cached_property
    def eye(self) -> Eye:
        """The field of view of a sweep."""
        return Eye.of(self.session.views[-1], self.session.config)

    @cached_property
    def surface(self) -> Patches:
        """The target's surface seen by all views, in ``world``."""
        return merge_patches(self.session)

    @cached_property
    def space(self) -> VoxelMap:
        """The voxel map of the space around the target."""
        return build_voxel_map(self.session, self.session.config.planning.standoff)

    @cached_property
    def _here(self) -> Pose2:
        return self.session.views[-1].T_world_scan

    @cached_property
    def _offered(self) -> tuple[tuple[Pose2, ...], FloatArray]:
        """Feasible poses in ``world`` and the lengths of the paths to them (m,) [m]."""
        places, towards = _find_ring(self.surface.points[:, :2], self.session)
        paths = self.path_lengths(places)
        poses, lengths = [], []
        for place, heading, length in zip(places, towards, paths, strict=True):
            if not np.isfinite(length):
                continue
            for turn in HEADING_OFFSETS:
                pose = Pose2(float(place[0]), float(place[1]), heading + turn)
                if self.is_allowed(pose):
                    poses.append(pose)
                    lengths.append(length)
        return tuple(poses), np.array(lengths)

    @property
    def poses(self) -> tuple[Pose2, ...]:
        """The feasible candidates ``T_world_scan``, in a fixed order."""
        return self._offered[0]

    @property
    def travel(self) -> FloatArray:
        """Length of the path to each candidate (m,) [m]."""
        return self._offered[1]

    @cached_property
    def turns(self) -> FloatArray:
        """Turn from the present heading to that of each candidate (m,) [rad]."""
        return np.array([abs(wrap(pose.yaw - self._here.yaw)) for pose in self.poses])

    def path_lengths(self, places: FloatArray) -> FloatArray:
        """Return the lengths of the paths (n,) [m] to ``places`` (n, 2) in ``world``, or inf."""
        T_odom_world = self.session.views[-1].observation.T_odom_scan @ self._here.inverse()
        return self.context.costmap.path_lengths(T_odom_world.apply(places))

    def is_allowed(self, pose: Pose2) -> bool:
        """Return whether ``pose`` belongs to the tour and is not that of an earlier view."""
        if self.session.config.tour == "front":
            back = np.array([-math.cos(pose.yaw), -math.sin(pose.yaw)])
            if abs(measure_angle(self.session.front, back)) > MAX_FRONT_ANGLE + 1e-6:
                return False
        return not any(
            pose.distance(view.T_world_scan) < SAME_POSE_DISTANCE
            and abs(wrap(pose.yaw - view.T_world_scan.yaw)) < SAME_POSE_ANGLE
            for view in self.session.views
        )

    @cached_property
    def rays(self) -> tuple[Rays, ...]:
        """Rays of a sweep at each candidate through the voxel map."""
        reach = 2 * self.session.config.planning.standoff
        return tuple(self.space.march(pose, self.eye, reach) for pose in self.poses)

    @cached_property
    def new_area(self) -> FloatArray:
        """Area (m,) [m2] of the unknown at the target's border that each candidate would see."""
        more = self.space.may_hold_more
        return np.array([rays.count_met(more) * VOXEL_SIZE**2 for rays in self.rays])

    @cached_property
    def worthwhile(self) -> tuple[int, ...]:
        """Indices of the candidates that would see enough new area."""
        least = self.session.config.baselines.min_new_area
        return tuple(int(i) for i in np.flatnonzero(self.new_area >= least))

    def termination_reason(self) -> str | None:
        """Return why no planner can plan a further view; None if one can."""
        if (
            len(self.session.views[-1].target.occupied_lines) < MIN_TARGET_LINES
            or len(self.surface) == 0
        ):
            return "target lost: the latest view shows nothing of it"
        return explain_view_limit(self.session)

    def nothing_new(self) -> Plan:
        """Return the plan for when no candidate is worthwhile: a panorama first, then the end."""
        if self.context.has_panorama:
            return stop_plan(f"{self.session.config.tour} complete: nothing new in sight")
        reason = "nothing new in sight from where the floor is known to be free: look around"
        return Plan(None, 0.0, math.nan, False, (), reason, needs_panorama=True)

    def go(
        self,
        pose: Pose2,
        reason: str,
        others: tuple[Pose2, ...] = (),
        error: float | None = None,
    ) -> Plan:
        """Return the plan to go to ``pose``.

        Args:
            pose: ``T_world_scan`` of the next sweep.
            reason: Why it goes there, in words.
            others: The runners-up, best first.
            error: Its predicted error [m] if the caller has it; None to predict it.
        """
        if error is None:
            error = predict_error(self.context, self._here.inverse() @ pose)
        chosen = self.candidate(pose, error)
        rest = tuple(self.candidate(other, math.nan) for other in others[:MAX_RUNNERS_UP])
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
        """Return ``pose`` as a candidate, with the overlap and predicted ``error`` [m]."""
        again = self.eye.sees(pose, self._latest, occluders=self.hiding)
        return Candidate(pose, measure_overlap(self._latest, again), error, feasible=True)

    @cached_property
    def _latest(self) -> Patches:
        view = self.session.views[-1]
        return extract_view_patches(view, self.session.workspace).moved(view.T_world_scan)

    @cached_property
    def hiding(self) -> FloatArray:
        """Points that may hide the target: the centres of all occupied voxels (n, 3) [m]."""
        return find_occupied_voxels(self.session, self.session.config.planning.standoff)


def _find_ring(target: FloatArray, session: Session) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) about a standoff from ``target`` (k, 2), and bearings of it (n,)."""
    # Lay a grid around the target
    standoff, step = session.config.planning.standoff, session.config.baselines.grid_step
    low, high = (
        target.min(axis=0) - MAX_STANDOFFS * standoff,
        target.max(axis=0) + MAX_STANDOFFS * standoff,
    )
    axes = [
        np.arange(np.floor(a / step), np.ceil(b / step) + 1) for a, b in zip(low, high, strict=True)
    ]
    places = step * np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)

    # Keep a ring of it
    distance, index = Tree.of(target).closest(places)
    ring = (distance >= MIN_STANDOFFS * standoff) & (distance <= MAX_STANDOFFS * standoff)
    to = target[index[ring]] - places[ring]
    return places[ring], np.arctan2(to[:, 1], to[:, 0])
