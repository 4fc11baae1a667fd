"""Encodes events, plans, registrations and session records as ROS 2 messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d_twin.core.types import (
    Candidate,
    LidarSpec,
    Plan,
    Pose2,
    RegistrationResult,
    ScanLine,
)
from scan3d_twin.recording.mcap import ros_messages as ros

INFO = 20
"""Level INFO of ``rcl_interfaces/Log``."""


def encode_log(stamp: float, text: str) -> ros.Message:
    """Return an event as a log message."""
    return ros.encode(
        "rcl_interfaces/msg/Log",
        stamp=ros.make_time(stamp),
        level=INFO,
        name="twin",
        msg=text,
        file="",
        function="",
        line=0,
    )


def encode_angles(line: ScanLine, spec: LidarSpec) -> ros.Message:
    """Return elevations [rad] and times after the stamp [s] of the beams of a scan line."""
    own = (line.elevations, line.beam_times)
    usual = (spec.elevations, spec.beam_times)
    elevations, times = (b if a is None else a for a, b in zip(own, usual, strict=True))
    return ros.encode(
        "scan3d_twin_msgs/msg/ScanAngles",
        header=ros.make_header(line.stamp, "laser"),
        elevations=elevations,
        times=times,
    )


def encode_plan(stamp: float, index: int, made: Plan) -> ros.Message:
    """Return the plan that was made after view ``index``, in ``world``."""
    return ros.encode(
        "scan3d_twin_msgs/msg/Plan",
        header=ros.make_header(stamp, "world"),
        view=index,
        finished=made.viewpoint is None,
        viewpoint=ros.make_pose(made.viewpoint or Pose2()),
        overlap=float(made.overlap),
        predicted_rmse=float(made.predicted_rmse),
        fell_back=bool(made.fell_back),
        needs_panorama=bool(made.needs_panorama),
        reason=made.reason,
        candidates=[_candidate(each) for each in made.candidates],
    )


def _candidate(each: Candidate) -> Any:
    return ros.make_message(
        "scan3d_twin_msgs/msg/Candidate",
        viewpoint=ros.make_pose(each.viewpoint),
        overlap=float(each.overlap),
        predicted_rmse=float(each.predicted_rmse),
        feasible=bool(each.feasible),
    )


def encode_registration(stamp: float, index: int, result: RegistrationResult) -> ros.Message:
    """Return the registration of view ``index`` on the one before it."""
    pose = ros.make_message(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=ros.make_pose(Pose2.from_matrix(result.T_target_source)),
        covariance=np.asarray(result.covariance, dtype=np.float64).ravel(),
    )
    return ros.encode(
        "scan3d_twin_msgs/msg/Registration",
        header=ros.make_header(stamp, "world"),
        view=index,
        converged=bool(result.converged),
        target_source=pose,
        fitness=float(result.fitness),
        inlier_rmse=float(result.inlier_rmse),
        predicted_rmse=float(result.predicted_rmse),
        num_inliers=int(result.num_inliers),
        iterations=int(result.iterations),
        ambiguity_gap=float(result.ambiguity_gap),
    )
