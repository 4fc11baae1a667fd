"""True poses of views, and the errors of their registration and their odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, Pose2, rms, wrap_all

TRUTH_LINES = 64
"""About the number of lines whose mean pose is the true one of a sweep: their errors of 0.6 mrad
leave 0.1."""

EVEN_LINES = 1.5
"""Lines that one side of an even sweep may have more than the other."""


@dataclass(frozen=True, slots=True)
class PairError:
    """Registration error of a view.

    Attributes:
        view: Index of the view.
        error: RMS displacement of its target points by ``T_prev_new`` from the true one [m].
        pose_error: RMS displacement of its target points in the world, after final alignment [m].
        odometry_error: ``error`` of the odometry, before registration [m]; NaN without odometry.
    """

    view: int
    error: float
    pose_error: float
    odometry_error: float


def find_true_pose(view: View, truth: Truth) -> Pose2:
    """Return the true ``T_map_scan`` of a view: where its lines as a whole were taken.

    Each line was read at a heading that is off by the line's own error, 0.6 mrad on a `typical`
    robot, and from a place that wanders by a millimetre while the base turns. The pose at a single
    line would count that line's error as one of the sweep's registration; the mean over
    ``TRUTH_LINES`` lines does not. Where a turntable turns the lidar the base stands: then any line
    tells where.
    """
    image = view.observation.image
    beam = image.spec.n_beams // 2
    headings, stamps = image.yaws[:, beam], image.stamps + image.spec.beam_times[beam]
    middle = int(np.argmin(np.abs(headings)))
    there = truth.pose_at(float(stamps[middle]))
    if image.T_scan_axis is not None:
        return there

    # Average over lines, relative to the one in the middle
    start = there @ Pose2(0.0, 0.0, -float(headings[middle]))
    even = find_even_lines(headings)
    headings, stamps = headings[even], stamps[even]
    every = max(1, len(stamps) // TRUTH_LINES)
    poses = truth.poses_at(stamps[::every])
    poses[:, 2] = wrap_all(poses[:, 2] - headings[::every] - start.yaw)
    x, y, turned = poses.mean(axis=0).tolist()
    return Pose2(x, y, start.yaw + turned)


def find_even_lines(headings: FloatArray) -> BoolArray:
    """Return which lines lie about heading 0 as far as there are lines to both sides (n,).

    All of them where there are none to one side. As the surfels of a registration have it
    (``native/extract_surfels.h``): an error of the yaw scale moves nothing at their mean.

    Args:
        headings: Of the lines (n,) [rad].
    """
    spacing = float(np.median(np.abs(np.diff(headings)))) if len(headings) > 1 else 0.0
    reach = min(np.max(headings), -np.min(headings)) + EVEN_LINES * spacing
    return np.asarray((np.abs(headings) <= reach) | (reach <= 0))


def lay_on_truth(session: Session, truth: Truth) -> Pose2:
    """Return ``T_map_world``, the alignment of the model to the truth by its first pose only."""
    return find_true_pose(session.views[0], truth) @ session.views[0].T_world_scan.inverse()


def measure_displacement(points: FloatArray, a: Pose2, b: Pose2) -> float:
    """Return the RMS distance [m] of ``points`` (n, 3) mapped by ``a`` and by ``b``."""
    return rms(a.apply(points) - b.apply(points))


def measure_view_error(k: int, session: Session, truth: Truth) -> float:
    """Return the RMS displacement of view ``k``'s points by ``T_prev_new`` from the true one [m].

    This is ``PairError.error``, known as soon as the view is registered.
    """
    true = find_true_pose(session.views[k - 1], truth).inverse() @ find_true_pose(
        session.views[k], truth
    )
    return _measure_registration_error(k, session, true)


def measure_pair_error(
    k: int, session: Session, true_poses: Sequence[Pose2], T_map_world: Pose2
) -> PairError:
    """Return the errors of view ``k``, given the true ``T_map_scan`` of all views."""
    previous, view = session.views[k - 1], session.views[k]
    points = _judged_points(view)
    true = true_poses[k - 1].inverse() @ true_poses[k]
    odometry = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    return PairError(
        view=k,
        error=_measure_registration_error(k, session, true),
        pose_error=measure_displacement(points, T_map_world @ view.T_world_scan, true_poses[k]),
        odometry_error=measure_displacement(points, odometry, true)
        if view.observation.has_odometry
        else math.nan,
    )


def _measure_registration_error(k: int, session: Session, T_prev_new: Pose2) -> float:
    previous, view = session.views[k - 1], session.views[k]
    registered = previous.T_world_scan.inverse() @ view.T_world_scan
    return measure_displacement(_judged_points(view), registered, T_prev_new)


def _judged_points(view: View) -> FloatArray:
    """Return the points of the target; all where the view shows nothing of it."""
    return view.target.points if len(view.target) else view.sweep.points
