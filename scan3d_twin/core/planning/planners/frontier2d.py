"""Frontier planner in the plane: the next best view is the one that sees the most unseen edge.

H. Surmann, A. Nuechter and J. Hertzberg, An autonomous mobile robot with a 3D laser range finder
for 3D exploration and digitalization of indoor environments, Robotics and Autonomous Systems 45,
2003: horizontal slices at several heights are polygons of seen and unseen edges, and the value of a
candidate is the length V of the unseen edges that it sees, V exp(-c1 d) exp(-c2 dtheta).
H. Gonzalez-Banos and J.-C. Latombe, Navigation strategies for exploring indoor environments, IJRR
21, 2002: its value is the unseen area A that may show behind those edges, A exp(-lambda L), if
enough solid edge is seen again for localisation. Here edges are borders of cells of the slices, and
only those at the target count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import stop_plan
from scan3d_twin.core.planning.surface.surface_patches import Eye
from scan3d_twin.core.planning.surface.voxels import (
    FLOOR_TOP,
    FREE,
    RAY_START,
    RAY_STEP,
    UNKNOWN,
    VOXEL_SIZE,
    VoxelMap,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, IntArray, Plan, Pose2

SLICE_HEIGHTS = (0.15, 0.30, 0.45)
"""Heights of the slices [m]: below, at and above the lidar; an assumption."""
COST_PER_METRE, COST_PER_RADIAN = 0.5, 0.2
"""The constants c1 [1/m] and c2 [1/rad] of the cost of travel; assumptions."""
AREA_COST_PER_METRE = 0.2
"""Cost of travel by Gonzalez-Banos and Latombe [1/m]; an assumption."""


@dataclass(frozen=True)
class Sight:
    """The mean of what one candidate sees in the slices.

    Attributes:
        unseen_edge: Length of unseen edges at the target [m].
        unseen_area: Unknown area behind them that may become visible [m2].
        solid_edge: Length of known edges [m].
    """

    unseen_edge: float
    unseen_area: float
    solid_edge: float


class Frontier2dPlanner:
    """The most unseen edge in horizontal slices (Surmann-Nuechter or Gonzalez-Banos)."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the candidate of the largest value."""
        candidates, config = PoseCandidates.of(session), session.config.baselines
        if reason := candidates.termination_reason():
            return stop_plan(reason)
        if not candidates.worthwhile:
            return candidates.nothing_new()

        # Value the candidates
        sights = [see_slices(pose, candidates) for pose in candidates.poses]
        if config.frontier == "surmann":
            length = np.array([sight.unseen_edge for sight in sights])
            cost = COST_PER_METRE * candidates.travel + COST_PER_RADIAN * candidates.turns
            values, what = length * np.exp(-cost), "most unseen edge"
        else:
            area = np.array([sight.unseen_area for sight in sights])
            solid = np.array([sight.solid_edge for sight in sights])
            values = np.where(solid >= config.min_solid_edge, area, 0.0)
            values, what = (
                values * np.exp(-AREA_COST_PER_METRE * candidates.travel),
                "most unseen area",
            )

        # Choose the best
        if values.max() <= 0.0:
            return candidates.nothing_new()
        return candidates.best(values, f"{what} for the travel, of {len(sights)} viewpoints")


def see_slices(pose: Pose2, candidates: PoseCandidates) -> Sight:
    """Return what a sweep at ``pose`` sees in the slices."""
    space = candidates.space
    reach = 2 * candidates.session.config.planning.standoff
    cells = _ray_cells(pose, candidates.eye, space, reach)
    sights = [_see_slice(cells, space, k) for k in _slice_layers(space)]
    return Sight(*(np.mean(sights, axis=0).tolist()))


def _slice_layers(space: VoxelMap) -> list[int]:
    """Return the layers of the map at ``SLICE_HEIGHTS``, up to its top."""
    layers = [int((height - FLOOR_TOP) / VOXEL_SIZE) for height in SLICE_HEIGHTS]
    return [k for k in layers if k < space.labels.shape[2]]


def _ray_cells(pose: Pose2, eye: Eye, space: VoxelMap, reach: float) -> IntArray:
    """Return the flat index in a slice of the cells along rays (n_rays, n_steps); -1 outside."""
    yaws = pose.yaw + np.arange(-eye.half_width, eye.half_width + 1e-9, RAY_STEP / 2)
    steps = np.arange(RAY_START, reach, VOXEL_SIZE)
    x = pose.x + np.cos(yaws)[:, None] * steps
    y = pose.y + np.sin(yaws)[:, None] * steps
    cells = np.floor((np.stack([x, y], axis=-1) - space.origin[:2]) / VOXEL_SIZE).astype(np.int64)
    nx, ny = space.labels.shape[:2]
    inside = np.all((cells >= 0) & (cells < (nx, ny)), axis=-1)
    return np.asarray(np.where(inside, cells[..., 0] * ny + cells[..., 1], -1))


def _see_slice(cells: IntArray, space: VoxelMap, layer: int) -> tuple[float, float, float]:
    """Return unseen edge [m], unseen area [m2] and solid edge [m] in one layer of the map."""
    # Find the first hit of each ray
    labels = space.labels[..., layer].ravel()
    along = np.where(cells >= 0, labels[cells], FREE)
    stops = along != FREE
    first = np.where(stops.any(axis=1), np.argmax(stops, axis=1), along.shape[1] - 1)
    hit = np.take_along_axis(cells, first[:, None], axis=1)[:, 0]

    # Sort the hits
    at_target = hit >= 0
    at_target &= space.may_hold_more[..., layer].ravel()[hit]
    solid = hit[(hit >= 0) & space.target[..., layer].ravel()[hit]]

    # Follow unknown cells behind them
    steps = np.arange(along.shape[1])
    run = np.logical_and.accumulate((along == UNKNOWN) | (steps < first[:, None]), axis=1)
    behind = run & (steps >= first[:, None]) & at_target[:, None] & (cells >= 0)
    return (
        VOXEL_SIZE * _count_different(hit[at_target]),
        VOXEL_SIZE**2 * _count_different(cells[behind]),
        VOXEL_SIZE * _count_different(solid),
    )


def _count_different(cells: FloatArray | IntArray) -> int:
    return len(np.unique(cells))
