"""Registration by other packages from PyPI, with the settings that were best for them here."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import open3d as o3d
import small_gicp
from genz_icp.config import GenZConfig
from genz_icp.mapping import get_voxel_hash_map
from genz_icp.registration import get_registration

Peer = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
REACH = 0.10
"""Correspondence distance [m]."""
KERNEL = 0.03
"""Scale of the robust kernels that take one [m]."""


def _small(kind: str, downsample: float, threads: int = 1, neighbours: int = 20) -> Peer:
    def run(target: np.ndarray, source: np.ndarray, init: np.ndarray) -> np.ndarray:
        a, tree = small_gicp.preprocess_points(target, downsample, neighbours, threads)
        b, _ = small_gicp.preprocess_points(source, downsample, neighbours, threads)
        if kind == "VGICP":
            voxels = small_gicp.GaussianVoxelMap(0.1)
            voxels.insert(a)
            return small_gicp.align(voxels, b, init, REACH, threads, 100).T_target_source
        return small_gicp.align(a, b, tree, init, kind, REACH, threads, 100).T_target_source

    return run


def _full(kind: str, neighbours: int = 20) -> Peer:
    def run(target: np.ndarray, source: np.ndarray, init: np.ndarray) -> np.ndarray:
        clouds = []
        for points in (target, source):
            cloud = small_gicp.PointCloud(points)
            tree = small_gicp.KdTree(cloud, num_threads=1)
            small_gicp.estimate_normals_covariances(cloud, tree, neighbours, 1)
            clouds.append((cloud, tree))
        (a, tree), (b, _) = clouds
        if kind == "VGICP":
            voxels = small_gicp.GaussianVoxelMap(0.1)
            voxels.insert(a)
            return small_gicp.align(voxels, b, init, REACH, 1, 100).T_target_source
        return small_gicp.align(a, b, tree, init, kind, REACH, 1, 100).T_target_source

    return run


def _two_stage(target: np.ndarray, source: np.ndarray, init: np.ndarray) -> np.ndarray:
    a, tree = small_gicp.preprocess_points(target, 0.01, 20, 1)
    b, _ = small_gicp.preprocess_points(source, 0.01, 20, 1)
    for reach in (0.10, 0.03):
        init = small_gicp.align(a, b, tree, init, "GICP", reach, 1, 100).T_target_source
    return init


def _open3d(kind: str, neighbours: int = 30) -> Peer:
    registration = o3d.pipelines.registration
    criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, 100)

    def run(target: np.ndarray, source: np.ndarray, init: np.ndarray) -> np.ndarray:
        clouds = []
        for points in (target, source):
            cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
            if kind in ("plane", "tukey", "symmetric"):
                cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(neighbours))
                cloud.orient_normals_towards_camera_location(np.array([0.0, 0.0, 0.3]))
            clouds.append(cloud)
        a, b = clouds
        if kind == "gicp":
            return registration.registration_generalized_icp(
                b,
                a,
                REACH,
                init,
                registration.TransformationEstimationForGeneralizedICP(),
                criteria,
            ).transformation
        estimation = {
            "point": registration.TransformationEstimationPointToPoint,
            "plane": registration.TransformationEstimationPointToPlane,
            "symmetric": registration.TransformationEstimationPointToPlane,
            "tukey": lambda: registration.TransformationEstimationPointToPlane(
                registration.TukeyLoss(k=KERNEL)
            ),
        }[kind]()
        return registration.registration_icp(b, a, REACH, init, estimation, criteria).transformation

    return run


def _genz(voxel: float, per_voxel: int) -> Peer:
    """GenZ-ICP (Lee et al., RA-L 2024): point to plane and to point, weighed by planarity.

    Its odometry registers a scan to a map of voxels; here the map is the target.
    """
    config = GenZConfig()
    config.mapping.voxel_size, config.mapping.max_points_per_voxel = voxel, per_voxel
    config.registration.max_num_threads = 1

    def run(target: np.ndarray, source: np.ndarray, init: np.ndarray) -> np.ndarray:
        with _silence():
            voxels = get_voxel_hash_map(config)
            voxels.update(target)
            registration = get_registration(config)
            found = registration.align_points_to_map(source, voxels, init, REACH, KERNEL)
        return np.asarray(found)

    return run


@contextmanager
def _silence() -> Iterator[None]:
    """Keep what GenZ-ICP prints about each registration off standard output."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


PEERS: dict[str, Peer] = {
    "small_gicp VGICP 2 cm": _small("VGICP", 0.02),
    "small_gicp VGICP 2 cm, 2 threads": _small("VGICP", 0.02, 2),
    "small_gicp VGICP full k100": _full("VGICP", 100),
    "small_gicp GICP": _full("GICP"),
    "small_gicp GICP 1 cm, two stages": _two_stage,
    "open3d point to plane k30": _open3d("plane"),
    "open3d point to plane k100, Tukey": _open3d("tukey", 100),
    "open3d GICP": _open3d("gicp"),
    "genz-icp 3 cm": _genz(0.03, 20),
    "genz-icp 2 cm": _genz(0.02, 20),
}
