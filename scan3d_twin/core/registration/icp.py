"""Registration of two scans: the paper's plain point-to-point ICP, eq. (1), for a yawing robot.

The motion between two viewpoints is planar, so ICP estimates (x, y, theta); z is used to find
correspondences and is left as it is.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import RegistrationConfig
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Pose2,
    RegistrationResult,
    Scan3D,
    read_only,
)

PLANAR = [0, 1, 5]
"""Rows of x, y and rz in a 6-vector ordered x y z rx ry rz."""
OVERLAP_DISTANCE = 0.03
"""Points this near to the other scan are assumed to show the same surface [m]: the odometry's error
over a step plus a few times the range noise."""
MIN_PAIRS = 10
"""Least number of correspondences for a reliable pose."""


def register(
    target: FloatArray,
    source: FloatArray,
    *,
    init_T_target_source: Pose2 | None = None,
    border: BoolArray | None = None,
    config: RegistrationConfig | None = None,
    tree: Tree | None = None,
) -> RegistrationResult:
    """Register ``source`` to ``target`` by point-to-point ICP in the plane, eq. (1).

    Args:
        target: Points (n, 3) [m], the paper's model set M.
        source: Points (m, 3) [m], the paper's data set D.
        init_T_target_source: Initial guess; identity by default.
        border: Target points (n,) beyond which the surface continues unseen: a source point whose
            nearest target point is one of them has no correspondence (Turk and Levoy 1994).
        config: Thresholds; by default those of ``RegistrationConfig``.
        tree: k-d tree of ``target``, if the caller has one.

    Returns:
        The result; ``converged`` is False if the iterations ran out, if there were too few
        correspondences, or if a set is empty.
    """
    config = config or RegistrationConfig()
    pose = init_T_target_source or Pose2()
    if len(target) < MIN_PAIRS or len(source) < MIN_PAIRS:
        return _unregistered(pose)

    # Iterate to convergence.
    source = _thin_out(source, config.max_points)
    tree = tree or Tree.of(target)
    settled, iterations = False, 0
    while not settled and iterations < config.max_iterations:
        iterations += 1
        moved = pose.apply(source)
        paired, index, _ = _find_correspondences(tree, moved, border, config)
        if np.count_nonzero(paired) < MIN_PAIRS:
            return _unregistered(pose)
        step = fit_planar(target[index[paired]], moved[paired])
        pose = step @ pose
        settled = (
            math.hypot(step.x, step.y) < config.translation_epsilon
            and abs(step.yaw) < config.rotation_epsilon
        )

    # Judge the final correspondences.
    moved = pose.apply(source)
    paired, _, distances = _find_correspondences(tree, moved, border, config)
    return _make_result(moved, distances[paired], pose, iterations, settled, config)


def fit_planar(target: FloatArray, source: FloatArray) -> Pose2:
    """Return the planar pose that minimises eq. (1) for known pairs (n, 2 or 3), in closed form."""
    target_mean, source_mean = target[:, :2].mean(axis=0), source[:, :2].mean(axis=0)
    a, b = source[:, :2] - source_mean, target[:, :2] - target_mean
    dot = float(np.einsum("ij,ij->", a, b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = Pose2(0.0, 0.0, math.atan2(cross, dot))
    shift = target_mean - turn.apply(source_mean)
    return Pose2(float(shift[0]), float(shift[1]), turn.yaw)


def select_overlapping_lines(target: Scan3D, source: Scan3D, init_T_target_source: Pose2) -> Scan3D:
    """Return the lines of ``source`` that overlap ``target``: at least half their points are near.

    The planner has chosen an overlap. Registering whole images instead would pull one image onto
    the other where they do not show the same surface.
    """
    if len(target) == 0 or len(source) == 0:
        return source.select(np.zeros(len(source), dtype=bool))
    moved = init_T_target_source.apply(source.points)
    near = np.isfinite(Tree.of(target.points).closest(moved, OVERLAP_DISTANCE)[0])
    total = np.bincount(source.lines, minlength=source.n_lines)
    hits = np.bincount(source.lines, weights=near, minlength=source.n_lines)
    return source.select((2 * hits >= total)[source.lines])


def find_border(scan: Scan3D, *, right: bool) -> BoolArray:
    """Return whether each point (n,) is on the border: the first line and, if ``right``, the last.

    A scan that ends at a silhouette has no border there: the end of the surface is a feature.
    """
    ends = scan.occupied_lines[[0, -1]] if right else scan.occupied_lines[:1]
    return np.isin(scan.lines, ends)


def _find_correspondences(
    tree: Tree, moved: FloatArray, border: BoolArray | None, config: RegistrationConfig
) -> tuple[BoolArray, IntArray, FloatArray]:
    """Return whether each point (m,) has a correspondence, its index and its distance [m]."""
    distances, index = tree.closest(moved, config.max_correspondence_distance)
    paired = np.isfinite(distances)
    if border is not None and config.border == "drop":
        paired[paired] = ~border[index[paired]]
    return paired, index, distances


def _make_result(
    moved: FloatArray,
    distances: FloatArray,
    pose: Pose2,
    iterations: int,
    settled: bool,
    config: RegistrationConfig,
) -> RegistrationResult:
    """Return the result for the source at its final pose and the distances of its pairs."""
    pairs = len(distances)
    fitness = pairs / len(moved)
    rmse = float(np.sqrt(np.mean(distances**2))) if pairs else math.nan

    # Covariance from the pairs.
    information = _information(moved, rmse)
    covariance = np.zeros((6, 6))
    covariance[np.ix_(PLANAR, PLANAR)] = np.linalg.pinv(information[np.ix_(PLANAR, PLANAR)])

    return RegistrationResult(
        T_target_source=read_only(pose.matrix()),
        covariance=read_only(covariance),
        information=read_only(information),
        fitness=fitness,
        inlier_rmse=rmse,
        predicted_rmse=_predict_rmse(moved, covariance),
        num_inliers=pairs,
        iterations=iterations,
        converged=settled and fitness >= config.min_fitness,
        degenerate_directions=read_only(np.zeros((0, 6))),
        ambiguity_gap=math.nan,
    )


def _information(points: FloatArray, rmse: float) -> FloatArray:
    """Return J^T J / rmse^2 (6, 6) of point-to-point pairs at ``points`` (n, 3), planar part only.

    Point-to-point pairs seem to constrain every direction, even a slide along a wall (Bonnabel et
    al., arXiv 1410.7632): this is the information the paper's ICP claims, not what it has.
    """
    x, y = points[:, 0], points[:, 1]
    planar = np.array(
        [
            [len(x), 0.0, -y.sum()],
            [0.0, len(x), x.sum()],
            [-y.sum(), x.sum(), float(np.sum(x * x + y * y))],
        ]
    )
    information = np.zeros((6, 6))
    information[np.ix_(PLANAR, PLANAR)] = planar / max(rmse, 1e-6) ** 2 if len(x) else 0.0
    return information


def _predict_rmse(points: FloatArray, covariance: FloatArray) -> float:
    """Return the expected RMS displacement [m] of ``points`` (n, 3) under ``covariance`` (6, 6)."""
    C = covariance[np.ix_(PLANAR, PLANAR)]
    x, y = points[:, 0], points[:, 1]
    squares = C[0, 0] + C[1, 1] + C[2, 2] * (x * x + y * y) + 2 * (x * C[1, 2] - y * C[0, 2])
    return float(np.sqrt(max(0.0, float(np.mean(squares)))))


def _thin_out(points: FloatArray, most: int) -> FloatArray:
    """Return at most ``most`` of ``points``, evenly spaced by index."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _unregistered(pose: Pose2) -> RegistrationResult:
    """Return the result for sets that cannot be registered: the initial guess, not converged."""
    nothing = read_only(np.zeros((6, 6)))
    return RegistrationResult.unregistered(read_only(pose.matrix()), nothing, nothing)
