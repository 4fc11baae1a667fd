"""Scan matching: the pose of a new view by registration on the previous one, else by odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config, PlanningConfig
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.registration import PosePrior, SurfelGrid, extract_surfels, icp, register
from scan3d_twin.core.registration.pose_prior import PLANAR, predict_rmse, shift_to_target
from scan3d_twin.core.session import View, Workspace
from scan3d_twin.core.types import (
    FloatArray,
    Pose2,
    RegistrationResult,
    Scan3D,
    read_only,
    rms,
    wrap,
)
from scan3d_twin.core.viewpoints import is_end_in_view

MIN_SIGMA_XY, MIN_SIGMA_YAW = 0.003, math.radians(0.2)
"""Standard deviations of a move of no length [m], [rad]: play of the wheels and the turning
centre."""
PRIOR_INNOVATIONS = 6.0
"""Weight of the configured motion error in degrees of freedom: those of two moves."""
MIN_VARIANCE_REDUCTION = 0.5
"""Share of the odometry's variance that registration must remove in a direction to measure the
odometry's error there."""


def match_to_previous(
    view: View, views: Sequence[View], config: Config, workspace: Workspace | None = None
) -> View:
    """Return ``view`` registered on the last of ``views``; by odometry where that fails.

    The surfels of ``view`` stay in the ``workspace``, for the planner and the next registration;
    those of the previous view are forgotten, as one view's take 13 MB.
    """
    if config.registration.engine == "grid":
        return _match_by_grid(view, views, config, workspace or Workspace())
    return _match_by_icp(view, views[-1], config)


def _match_by_grid(view: View, views: Sequence[View], config: Config, workspace: Workspace) -> View:
    """Register by the grid engine; odometry is the prior, so that the result is never worse."""
    # Predict by odometry
    previous, scale = views[-1], estimate_odometry_scale(views, config)
    move = previous.T_world_scan.inverse() @ view.T_world_scan
    prior = motion_prior(move, config.planning, scale)

    # Register on the previous view
    try:
        result = register(
            surfels_of(previous, config, workspace),
            keep_surfels(view, config, workspace),
            prior=prior,
            starts=config.registration.starts,
        )
    except RegistrationError:
        result = _fall_back_to_odometry(prior)
        result = replace(result, predicted_rmse=_predict_rmse(result, view))
        return replace(view, registration=result)
    finally:
        workspace.results_of(previous.observation.image).pop(SurfelGrid, None)

    # Place the view in the world
    result = replace(result, predicted_rmse=_predict_rmse(result, view))
    T_world_scan = previous.T_world_scan @ Pose2.from_matrix(result.T_target_source)
    return replace(view, T_world_scan=T_world_scan, registration=result)


def _predict_rmse(result: RegistrationResult, view: View) -> float:
    """Return the expected RMS displacement [m] of the points that are modelled, the target's."""
    points = view.target.points if len(view.target) else view.sweep.points
    return predict_rmse(Pose2.from_matrix(result.T_target_source).apply(points), result.covariance)


def estimate_odometry_scale(views: Sequence[View], config: Config) -> float:
    """Return the factor by which this robot's odometry errors exceed the configured ones.

    It is estimated from innovations: a registration moves the pose by d from the prior's mean. With
    P the prior's covariance and C the result's, d has the covariance P - C; where C is small
    compared with P, d^T (P - C)^-1 d estimates the squared factor. The configured error counts like
    ``PRIOR_INNOVATIONS`` such squares of 1. Only the motion prior is scaled, not the error that
    registration adds.
    """
    square, count = PRIOR_INNOVATIONS, PRIOR_INNOVATIONS
    for previous, view in pairwise(views):
        if view.registration is not None and view.registration.converged:
            move = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
            prior = motion_prior(move, config.planning)
            innovation = _normalise_innovation(prior, view.registration)
            square += float(innovation @ innovation)
            count += len(innovation)
    return math.sqrt(square / count)


def _normalise_innovation(prior: PosePrior, result: RegistrationResult) -> FloatArray:
    """Return the normalised innovations (k,) in the directions that registration determines."""
    rows = np.ix_(PLANAR, PLANAR)
    back = np.linalg.inv(shift_to_target(result.T_target_source))
    C = (back @ result.covariance @ back.T)[rows]
    whitener = np.linalg.inv(np.linalg.cholesky(prior.covariance[rows]))
    gained, directions = np.linalg.eigh(np.eye(3) - whitener @ C @ whitener.T)
    d = directions.T @ whitener @ prior.deviation(result.T_target_source)[list(PLANAR)]
    determined = gained > MIN_VARIANCE_REDUCTION
    return np.asarray(d[determined] / np.sqrt(gained[determined]))


def surfels_of(view: View, config: Config, workspace: Workspace | None = None) -> SurfelGrid:
    """Return the surfels of a view's readings in ``registration.scope``.

    Args:
        view: The view.
        config: Scope of the readings, and errors that they share.
        workspace: Holds those that ``keep_surfels`` has kept; None to compute them.
    """
    # Recall or extract them
    image, scope = view.observation.image, _select_scope(view, config.registration.scope)
    kept = None if workspace is None else workspace.results_of(image).get(SurfelGrid)
    if kept is not None and kept[0] is scope:
        grid = SurfelGrid(image, *kept[1:])
    else:
        grid = extract_surfels(image, keep=_clear_of_floor(scope, config))

    # Add the errors that readings share
    noise = replace(
        grid.noise,
        yaw_scale_sigma=config.registration.yaw_scale_sigma,
        bias_sigma=config.registration.bias_sigma,
        linearity_sigma=config.registration.linearity_sigma,
        offset_sigma=config.registration.offset_sigma,
    )
    return replace(grid, noise=noise)


def _clear_of_floor(scan: Scan3D, config: Config) -> Scan3D:
    """Return ``scan`` without its lowest points, whose surfels would lean towards the floor."""
    return scan.select(scan.points[:, 2] > config.target.floor_height)


def keep_surfels(view: View, config: Config, workspace: Workspace) -> SurfelGrid:
    """Return ``surfels_of`` a view and keep them in the ``workspace``."""
    grid = surfels_of(view, config, workspace)
    workspace.results_of(view.observation.image)[SurfelGrid] = (
        _select_scope(view, config.registration.scope),
        grid.noise, grid.rows, grid.yaws, grid.index, grid.valid, grid.line_spacing,
    )  # fmt: skip
    return grid


def motion_prior(move: Pose2, config: PlanningConfig, scale: float = 1.0) -> PosePrior:
    """Return the prior of a move by turn, drive and turn, about the viewpoint it leads to.

    Let D be the length of the drive and t1, t2 the turns before and after it. The standard
    deviations are

    * lambda D along the drive;
    * lambda D, D gamma t1 and delta D^2 / 2 across it, as the heading is off by gamma t1 at its
      start and drifts by delta D until its end;
    * gamma (t1 + t2) and delta D of the final heading,

    all independent of each other and multiplied by ``scale``.

    Args:
        move: The move ``T_previous_next``.
        config: Its ``lambda_``, ``gamma`` and ``drift`` (delta).
        scale: Factor on all errors, see ``estimate_odometry_scale``.
    """
    # Split the move and its errors
    D = math.hypot(move.x, move.y)
    bearing = math.atan2(move.y, move.x) if D > 0.01 else 0.0
    before, after = config.gamma * abs(bearing), config.gamma * abs(wrap(move.yaw - bearing))
    drift, slip = config.drift * D, config.lambda_ * D

    # Sum up variances along the drive
    C = np.zeros((3, 3))
    C[0, 0] = slip**2 + MIN_SIGMA_XY**2
    C[1, 1] = slip**2 + (D * before) ** 2 + (drift * D / 2) ** 2 + MIN_SIGMA_XY**2
    C[2, 2] = (before + after) ** 2 + drift**2 + MIN_SIGMA_YAW**2
    C[1, 2] = C[2, 1] = D * before * before + drift * drift * D / 2

    # Turn them into the frame
    along = Pose2(0.0, 0.0, bearing).matrix()[:3, :3]
    return PosePrior.of_robot(move, scale**2 * along @ C @ along.T)


def _fall_back_to_odometry(prior: PosePrior) -> RegistrationResult:
    """Return the result for views that do not overlap: odometry with its covariance."""
    information = read_only(np.linalg.inv(prior.covariance))
    return RegistrationResult.unregistered(prior.T, prior.covariance, information)


def _match_by_icp(view: View, previous: View, config: Config) -> View:
    """Register by the paper's ICP; keep odometry where it fails or has slid along the surface.

    ICP has slid when it moves the target by more than the largest correspondence distance.
    """
    result = _register_by_icp(view, previous, config)
    T_world_scan = previous.T_world_scan @ Pose2.from_matrix(result.T_target_source)
    points = view.target.points
    correction = T_world_scan.apply(points) - view.T_world_scan.apply(points)
    slid = rms(correction) > config.registration.max_correspondence_distance
    result = replace(result, converged=result.converged and not slid)
    placed = T_world_scan if result.converged else view.T_world_scan
    return replace(view, T_world_scan=placed, registration=result)


def _register_by_icp(view: View, previous: View, config: Config) -> RegistrationResult:
    """Register ``view`` on ``previous`` where, by odometry, they are expected to overlap."""
    # Select the lines expected to overlap
    init = previous.T_world_scan.inverse() @ view.T_world_scan
    target, source = (_select_scope(v, config.registration.scope) for v in (previous, view))
    source = icp.select_overlapping_lines(target, source, init)
    if len(target) == 0 or len(source) == 0:
        return icp.register(target.points, source.points, init_T_target_source=init)

    # Register with the border known
    ends = config.registration.scope == "target" and is_end_in_view(
        previous.image, previous.sweep, previous.target, config.target
    )
    return icp.register(
        target.points,
        source.points,
        init_T_target_source=init,
        border=icp.find_border(target, right=not ends),
        config=config.registration,
    )


def _select_scope(view: View, scope: str) -> Scan3D:
    """Return the points of ``view`` that ``registration.scope`` selects."""
    return view.target if scope == "target" else view.sweep
