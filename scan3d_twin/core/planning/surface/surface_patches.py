"""The target's surface as small patches, and which of them a sweep from a viewpoint would see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.model.fused_cloud import thin_by_voxel
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session, View, Workspace
from scan3d_twin.core.types import BoolArray, FloatArray, Pose2

PATCH_SIZE = 0.04
"""Side of a patch [m]: at 1 m a few readings, so that its normal is not dominated by noise."""
NORMAL_NEIGHBOURS = 12
"""Number of patches to which a normal is fitted; on a surface they are within two patches."""
MIN_COSINE = 0.10
"""Cosine of the incidence below which (84 deg) a patch is not seen."""
DEPTH_CELL = math.radians(3.0)
"""Side of a cell of the depth buffer [rad]: wider than a patch at 1 m, so that surfaces have no
holes."""
SURFACE_DEPTH, DEPTH_PER_METRE = 0.08, 0.05
"""Depth of one surface within a cell [m], and its growth per metre of range: a surface at 60 deg
incidence recedes by 0.09 m over a cell at 1 m."""


@dataclass(frozen=True)
class Patches:
    """Pieces of surface of about ``PATCH_SIZE`` squared.

    Attributes:
        points: Their centres (n, 3) [m].
        normals: Unit normals towards where they were seen from (n, 3).
        variation: Surface variation l3 / (l1 + l2 + l3), 0 for a plane (Pauly et al. 2002) (n,).
    """

    points: FloatArray
    normals: FloatArray
    variation: FloatArray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, mask: BoolArray) -> Patches:
        """Return the patches where ``mask`` (n,) is True."""
        return Patches(self.points[mask], self.normals[mask], self.variation[mask])

    def moved(self, T: Pose2) -> Patches:
        """Return the patches in frame a of ``T_a_b``."""
        return Patches(T.apply(self.points), T.rotate(self.normals), self.variation)


def extract_patches(points: FloatArray, eye: FloatArray) -> Patches:
    """Return the patches of ``points`` (n, 3) that were seen from ``eye`` (3,), in one frame."""
    # Thin the points out
    thinned = thin_by_voxel(points, PATCH_SIZE)
    if len(thinned) < NORMAL_NEIGHBOURS:
        return Patches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))

    # Fit planes to their neighbours
    _, index = Tree.of(thinned).nearest(thinned, NORMAL_NEIGHBOURS)
    around = thinned[index] - thinned[index].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    normals = vectors[..., 0]

    # Turn the normals towards the eye
    away = np.einsum("ni,ni->n", normals, thinned - eye) > 0
    normals = np.where(away[:, None], -normals, normals)
    return Patches(thinned, normals, values[:, 0] / np.maximum(values.sum(axis=1), 1e-12))


def extract_view_patches(view: View, workspace: Workspace | None = None) -> Patches:
    """Return the patches of the target in ``view``, in ``scan``; the ``workspace`` keeps them."""
    kept = {} if workspace is None else workspace.results_of(view.image)
    if Patches not in kept or kept[Patches][0] is not view.target:
        eye = np.array([0.0, 0.0, lidar_height(view)])
        kept[Patches] = view.target, extract_patches(view.target.points, eye)
    patches: Patches = kept[Patches][1]
    return patches


def merge_patches(session: Session) -> Patches:
    """Return the patches of all views in ``world``, the first one in each cell."""
    parts = [
        extract_view_patches(view, session.workspace).moved(view.T_world_scan)
        for view in session.views
    ]
    points = np.concatenate([part.points for part in parts])
    cells = np.floor(points / PATCH_SIZE).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    first.sort()
    return Patches(
        points[first],
        np.concatenate([part.normals for part in parts])[first],
        np.concatenate([part.variation for part in parts])[first],
    )


def lidar_height(view: View) -> float:
    """Return the height of the lidar [m]."""
    return float(view.image.T_base_lidar[2, 3])


@dataclass(frozen=True)
class Eye:
    """The field of view of a sweep.

    Attributes:
        height: Height of the lidar [m]; that it is 5 cm ahead of the axle is neglected here.
        half_width: Half the horizontal angle [rad].
        half_window: Half the vertical angle [rad].
        max_range: Longest range [m].
    """

    height: float
    half_width: float
    half_window: float
    max_range: float

    @staticmethod
    def of(view: View, config: Config) -> Eye:
        """Return the field of view of a run's sweeps without their margins."""
        width, target = config.sweep.width / 2, config.target
        return Eye(lidar_height(view), width, target.window / 2, target.max_range)

    def sees(self, pose: Pose2, patches: Patches, occluders: FloatArray | None = None) -> BoolArray:
        """Return which ``patches`` (n,) a sweep at ``pose`` sees; everything is in one frame.

        Args:
            pose: Pose of the sweep.
            patches: The patches, which may hide each other.
            occluders: Other points (m, 3) that may hide them [m].
        """
        if len(patches) == 0:
            return np.zeros(0, dtype=bool)

        # Measure direction and incidence
        yaw, elevation, distance, inside = self._look(pose, patches.points)
        eye = np.array([pose.x, pose.y, self.height])
        cosine = np.einsum("ni,ni->n", patches.normals, eye - patches.points) / distance

        # Compare with the depth buffer
        cells, ranges = [_depth_cells(yaw, elevation)], [np.where(inside, distance, np.inf)]
        if occluders is not None and len(occluders):
            other_yaw, other_elevation, other, within = self._look(pose, occluders)
            cells.append(_depth_cells(other_yaw, other_elevation))
            ranges.append(np.where(within, other, np.inf))
        nearest = _nearest(np.concatenate(cells), np.concatenate(ranges))[: len(patches)]
        hidden = distance > nearest * (1 + DEPTH_PER_METRE) + SURFACE_DEPTH
        return np.asarray(inside & (cosine > MIN_COSINE) & ~hidden)

    def cosines(self, pose: Pose2, patches: Patches) -> FloatArray:
        """Return the cosine of the incidence (n,) from ``pose`` on ``patches``."""
        rays = np.array([pose.x, pose.y, self.height]) - patches.points
        lengths = np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
        return np.asarray(np.einsum("ni,ni->n", patches.normals, rays) / lengths)

    def _look(
        self, pose: Pose2, points: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return yaw and elevation [rad], distance [m] and whether in view, each (n,)."""
        local = pose.inverse().apply(points)
        flat, up = np.hypot(local[:, 0], local[:, 1]), local[:, 2] - self.height
        yaw, elevation = np.arctan2(local[:, 1], local[:, 0]), np.arctan2(up, flat)
        distance = np.maximum(np.hypot(flat, up), 1e-9)
        inside = (np.abs(yaw) <= self.half_width) & (np.abs(elevation) <= self.half_window)
        return yaw, elevation, distance, inside & (distance <= self.max_range)


def _depth_cells(yaw: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return the cell of the depth buffer of each direction (n,)."""
    columns = math.ceil(math.tau / DEPTH_CELL) + 1
    across = np.floor((yaw + math.pi) / DEPTH_CELL)
    return np.asarray(across + columns * np.floor((elevation + math.pi / 2) / DEPTH_CELL))


def _nearest(cells: FloatArray, ranges: FloatArray) -> FloatArray:
    """Return the smallest range in the cell of each point (n,)."""
    _, index = np.unique(cells, return_inverse=True)
    nearest = np.full(int(index.max()) + 1, np.inf)
    np.minimum.at(nearest, index, ranges)
    return np.asarray(nearest[index])


def measure_overlap(latest: Patches, seen: BoolArray) -> float:
    """Return the share of the patches of the ``latest`` view that are ``seen`` (n,) again."""
    return float(np.mean(seen)) if len(latest) else 0.0
