"""Scan matching: the pose of a new view by registration on the previous one, else by odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.motion_model import MotionModel, describe_move
from scan3d_twin.core.registration import PosePrior, SurfelGrid, extract_surfels, icp, register
from scan3d_twin.core.registration.pose_prior import predict_rmse
from scan3d_twin.core.session import TurnScale, View, Workspace
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Pose2,
    RegistrationResult,
    Scan3D,
    read_only,
    rms,
)
from scan3d_twin.core.viewpoints import is_end_in_view

MIN_CHANGE = 0.5
"""Change of the known scale of turns, in its standard deviations, for which sweeps are corrected
anew (assumption)."""
MAX_BEND = 0.001
"""Displacement of the prior's mean by how a move bends for which views are registered again [m]: a
small part of the errors of registration."""


def predict_pose(views: Sequence[View], observation: Observation, motion: MotionModel) -> Pose2:
    """Return ``T_world_scan`` of a sweep by odometry from the latest view, its errors corrected.

    The first view defines the world; ``motion`` is what the ``views`` show of those errors.
    """
    if not views:
        return observation.T_odom_scan
    move, legs = describe_move(views[-1], observation)
    return views[-1].T_world_scan @ motion.correct(move, legs)


def match_to_previous(
    view: View,
    views: Sequence[View],
    config: Config,
    motion: MotionModel,
    workspace: Workspace | None = None,
) -> View:
    """Return ``view`` registered on the last of ``views``; by odometry where that fails.

    ``motion`` is what the ``views`` show of the errors of the odometry.

    The surfels of ``view`` stay in the ``workspace``, for the planner and the next registration;
    those of the previous view are forgotten, as one view's take 13 MB.
    """
    if config.registration.engine == "grid":
        return _match_by_grid(view, views[-1], config, motion, workspace or Workspace())
    return _match_by_icp(view, views[-1], config)


def _match_by_grid(
    view: View, previous: View, config: Config, motion: MotionModel, workspace: Workspace
) -> View:
    """Register by the grid engine; odometry is the prior, so that the result is never worse."""
    move, legs = describe_move(previous, view.observation)
    prior = motion.prior(move, legs)

    # Register on the previous view, again by what that shows of the robot
    try:
        result = _register_sweeps(previous, view, config, prior, workspace)
        learned = motion.learn(move, legs, result)
        better, turns = motion.prior(move, legs, learned.mean), _find_better_turns(view, learned)
        if turns is not None or _is_apart(prior, better):
            before, after = (
                each if turns is None else each.with_turns(turns) for each in (previous, view)
            )
            with suppress(RegistrationError):
                result = _register_sweeps(before, after, config, better, workspace)
                previous, view = before, after
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


def _is_apart(prior: PosePrior, better: PosePrior) -> bool:
    """Return whether a prior has moved by more than ``MAX_BEND``."""
    return math.dist(prior.T[:2, 3], better.T[:2, 3]) > MAX_BEND


def _find_better_turns(view: View, motion: MotionModel) -> TurnScale | None:
    """Return the scale of turns by which a ``view`` should be corrected; None where it is so."""
    turns = motion.turns
    if turns is None or view.observation.image.T_scan_axis is not None:
        return None
    used = 0.0 if view.turns is None else view.turns.scale
    return turns if abs(turns.scale - used) > MIN_CHANGE * turns.sigma else None


def _register_sweeps(
    previous: View, view: View, config: Config, prior: PosePrior, workspace: Workspace
) -> RegistrationResult:
    """Return the registration of ``view`` on ``previous`` by surfels, else by their points.

    Raises:
        RegistrationError: The views do not overlap, or they contradict each other.
    """
    try:
        target = surfels_of(previous, config, workspace)
        source = keep_surfels(view, config, workspace)
    except RegistrationError:
        return register_points(select_points(previous, config), select_points(view, config), prior)
    result = register(target, source, prior=prior, starts=config.registration.starts)
    if not result.converged:
        raise RegistrationError("the two views contradict each other")
    return result


def select_points(view: View, config: Config) -> FloatArray:
    """Return the points (n, 3) [m] of a view's readings in ``registration.scope``."""
    return _clear_of_floor(select_scope(view, config.registration.scope), config).points


def register_points(target: FloatArray, source: FloatArray, prior: PosePrior) -> RegistrationResult:
    """Return the registration of views that show too little surface for surfels, by their points.

    Legs and handles are narrower than the window of a surfel, so that a few hundred readings of
    them give next to none.

    Args:
        target: Points (n, 3) of the view registered on [m].
        source: Points (m, 3) of the view that is registered [m].
        prior: Prior of its pose.

    Raises:
        RegistrationError: The points are too few, do not overlap, or contradict each other.
    """
    result = register(target, source, prior=prior)
    if not result.converged:
        raise RegistrationError("the points of the two views contradict each other")
    return result


def _predict_rmse(result: RegistrationResult, view: View) -> float:
    """Return the expected RMS displacement [m] of the points that are modelled, the target's."""
    points = view.target.points if len(view.target) else view.sweep.points
    return predict_rmse(Pose2.from_matrix(result.T_target_source).apply(points), result.covariance)


def surfels_of(view: View, config: Config, workspace: Workspace | None = None) -> SurfelGrid:
    """Return the surfels of a view's readings in ``registration.scope``.

    Args:
        view: The view.
        config: Scope of the readings, and errors that they share.
        workspace: Holds those that ``keep_surfels`` has kept; None to compute them.
    """
    # Recall or extract them
    image, scope = view.measured_image, select_scope(view, config.registration.scope)
    results = None if workspace is None else workspace.results_of(view.observation.image)
    kept = None if results is None else results.get(SurfelGrid)
    if kept is not None and kept[0] is scope:
        grid = SurfelGrid(image, *kept[1:])
    else:
        grid = extract_surfels(image, keep=_clear_of_floor(scope, config))

    # Add the errors that readings share
    turns = view.turns
    noise = replace(
        grid.noise,
        yaw_scale_sigma=config.registration.yaw_scale_sigma if turns is None else turns.sigma,
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
        select_scope(view, config.registration.scope),
        grid.noise, grid.rows, grid.yaws, grid.index, grid.valid, grid.line_spacing,
    )  # fmt: skip
    return grid


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
    target, source = (select_scope(v, config.registration.scope) for v in (previous, view))
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


def select_scope(view: View, scope: str) -> Scan3D:
    """Return the points of ``view`` that ``registration.scope`` selects."""
    return view.target if scope == "target" else view.sweep
