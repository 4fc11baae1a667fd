"""A session as an .rrd file for rerun (rerun.io), which has no types for most ROS 2 messages.

Views and plans come from the session itself, at their final poses; the robot, its path and the scan
lines from the messages of the drive. So recordings of earlier versions can be written too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan, Pose2
from scan3d_twin.recording.colours import GREY, view_colours_rgb
from scan3d_twin.recording.export.format import RecordingFormat
from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.recovering_reader import RawMessage, read_contents
from scan3d_twin.recording.mcap.ros_display import (
    ARROW_LENGTH,
    INFEASIBLE_COLOUR,
    NEXT_COLOUR,
    PATH_STEP,
    find_target,
)
from scan3d_twin.recording.names import SCANS
from scan3d_twin.run.folder import write_file

TIMELINE = "robot_time"
"""Time on the robot's clock, from when it was opened [s]."""
SCAN_COLOUR, PATH_COLOUR = (235, 50, 50), (255, 176, 0)
"""Colours of the scan line and of the path, as in the live view and in Foxglove's layout."""
POINT_RADIUS, DOT_RADIUS, PATH_RADIUS = 0.003, 0.02, 0.008
"""Radii of the points of clouds, of candidates and of the path [m]."""
EYE_DISTANCE = 4.0
"""Distance of the eye from the target's middle when the viewer opens, 45 degrees up [m]."""
SPEED = 10.0
"""Playback speed, that at which the live view plays the twin."""
PATH_BATCH = 5
"""Steps after which the path is written anew, as a whole: what is shown is the last state."""
_DRIVE = ("/tf", "/tf_static", SCANS, "/rosout")


def write(session_file: Path, path: Path) -> None:
    """Write the session in ``session_file`` as the file ``path``.

    Raises:
        ConfigError: rerun is missing.
        FileError: The session cannot be read, or the file cannot be written.
    """
    try:
        import rerun
    except ImportError as error:
        raise ConfigError("rrd files need rerun: pip install rerun-sdk") from error

    # Collect the stream, then write it: rerun's own file waits for ever on a full disk
    recorded = load_session(session_file)
    with rerun.RecordingStream(f"scan3d_twin {recorded.name}") as stream:
        content = stream.binary_stream()
        stream.send_blueprint(_blueprint(recorded.session))
        _RerunWriter(rerun, stream).write(recorded.session, session_file)
        data = content.read() or b""
    write_file(path, data)


def _blueprint(session: Session) -> Any:
    """Return how rerun's viewer opens: 3D, errors and events, at the end of the run."""
    from rerun import blueprint

    seen = [view.T_world_scan.apply(view.target.points) for view in session.views]
    middle = np.concatenate([np.zeros((0, 3)), *seen, np.zeros((1, 3))]).mean(axis=0)
    eye = middle + EYE_DISTANCE * np.append(session.front, 1.0) / math.sqrt(2.0)
    return blueprint.Blueprint(
        blueprint.Horizontal(
            blueprint.Spatial3DView(
                origin="world",
                name="Run",
                eye_controls=blueprint.EyeControls3D(
                    position=eye, look_target=middle, eye_up=(0.0, 0.0, 1.0)
                ),
            ),
            blueprint.Vertical(
                blueprint.TimeSeriesView(origin="errors_mm", name="Errors [mm]"),
                blueprint.TextLogView(origin="events", name="Events"),
            ),
            column_shares=[2, 1],
        ),
        blueprint.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following", playback_speed=SPEED
        ),
        collapse_panels=True,
    )


class _RerunWriter:
    """Logs a session to a stream of the module ``rerun``."""

    def __init__(self, rerun: Any, stream: Any) -> None:
        self._rr, self._stream = rerun, stream
        self._path: list[tuple[float, float, float]] = []

    def write(self, session: Session, session_file: Path) -> None:
        """Log everything, in the order of time within each entity."""
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.log("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._write_drive(session_file)
        for index in range(len(session.views)):
            self._write_view(session, index)
            if index < len(session.plans):
                self._write_plan(_end_of_view(session, index), session.plans[index])
        if session.stop_reason:
            self._stream.log("events", self._rr.TextLog(f"end: {session.stop_reason}"))

    def _write_view(self, session: Session, index: int) -> None:
        """Log view ``index``: what it saw of the target, what else, and where it was taken."""
        view, name = session.views[index], f"{index:03d}"
        self._set_time(_end_of_view(session, index))
        colour = view_colours_rgb(np.array([index]))[0]
        apply = view.T_world_scan.apply
        rest = view.sweep.points[~find_target(view)]
        clouds = (("model", view.target.points, colour), ("surroundings", rest, GREY))
        for entity, cloud, shade in clouds:
            points = self._rr.Points3D(apply(cloud), colors=[shade], radii=POINT_RADIUS)
            self._stream.log(f"world/{entity}/{name}", points)
        label = f"view {index}"
        self._stream.log(f"world/views/{name}", self._arrow(view.T_world_scan, colour, label))

        # Registration on the view before
        result = view.registration
        if result is not None:
            self._log_error("registration", result.inlier_rmse)

    def _write_plan(self, stamp: float, plan: Plan) -> None:
        """Log what was considered and decided."""
        self._set_time(stamp)
        candidates = plan.candidates
        dots = self._rr.Points3D(
            [(each.viewpoint.x, each.viewpoint.y, 0.0) for each in candidates],
            colors=[GREY if each.feasible else INFEASIBLE_COLOUR for each in candidates],
            radii=DOT_RADIUS,
            labels=[_describe(each.overlap, each.predicted_rmse) for each in candidates],
            show_labels=False,
        )
        self._stream.log("world/plan/candidates", dots)
        if plan.viewpoint is None:
            self._stream.log("world/plan/next", self._rr.Clear(recursive=False))
        else:
            label = _describe(plan.overlap, plan.predicted_rmse)
            self._stream.log("world/plan/next", self._arrow(plan.viewpoint, NEXT_COLOUR, label))
            self._log_error("predicted", plan.predicted_rmse)
        self._stream.log("events", self._rr.TextLog(f"plan: {plan.reason}"))

    def _log_error(self, name: str, error: float) -> None:
        """Log ``error`` [m]; NaN is unknown."""
        if math.isfinite(error):
            self._stream.log(f"errors_mm/{name}", self._rr.Scalars(1e3 * error))

    def _arrow(self, pose: Pose2, colour: Any, label: str) -> Any:
        x, y = ARROW_LENGTH * math.cos(pose.yaw), ARROW_LENGTH * math.sin(pose.yaw)
        return self._rr.Arrows3D(
            origins=[(pose.x, pose.y, 0.0)],
            vectors=[(x, y, 0.0)],
            colors=[colour],
            radii=DOT_RADIUS / 2,
            labels=[label],
        )

    def _write_drive(self, session_file: Path) -> None:
        """Log robot, path, scan lines and events as they were recorded."""
        mount, base = np.eye(4), Pose2()
        for topic, stamp, message in _messages(session_file):
            self._set_time(stamp)
            is_frame = topic in ("/tf", "/tf_static")
            if is_frame and message.transforms[0].child_frame_id == "laser":
                mount = _matrix(message.transforms[0].transform)
            elif topic == "/tf":
                base = _base_in_world(message)
                self._write_robot(base)
            elif topic == SCANS:
                points = _scan_points(message) @ mount[:3, :3].T + mount[:3, 3]
                line = self._rr.Points3D(
                    base.apply(points), colors=[SCAN_COLOUR], radii=POINT_RADIUS
                )
                self._stream.log("world/scan", line)
            else:
                self._stream.log("events", self._rr.TextLog(message.msg, level="INFO"))
        self._write_path()

    def _write_robot(self, base: Pose2) -> None:
        """Log where the robot is, and its path where it has moved on."""
        self._stream.log("world/robot", self._arrow(base, PATH_COLOUR, "robot"))
        if not self._path or math.dist(self._path[-1][:2], (base.x, base.y)) >= PATH_STEP:
            self._path.append((base.x, base.y, 0.0))
            if len(self._path) % PATH_BATCH == 0:
                self._write_path()

    def _write_path(self) -> None:
        strip = self._rr.LineStrips3D([self._path], colors=[PATH_COLOUR], radii=PATH_RADIUS)
        self._stream.log("world/path", strip)

    def _set_time(self, stamp: float) -> None:
        self._stream.set_time(TIMELINE, duration=stamp)


def _end_of_view(session: Session, index: int) -> float:
    """Return when the sweep of view ``index`` was complete, on the robot's clock [s]."""
    return float(session.views[index].image.stamps.max())


def _describe(overlap: float, predicted: float) -> str:
    """Return overlap and predicted error of a viewpoint in words."""
    error = f", {1e3 * predicted:.1f} mm" if math.isfinite(predicted) else ""
    return f"overlap {overlap:.0%}{error}"


def _messages(session_file: Path) -> Iterator[tuple[str, float, Any]]:
    """Yield topic, stamp [s] and content of the messages of the drive."""
    for each in read_contents(session_file, *_DRIVE):
        if isinstance(each, RawMessage):
            message = ros.typestore().deserialize_cdr(each.data, each.name)
            yield each.topic, each.nanoseconds / 1e9, message


def _base_in_world(message: Any) -> Pose2:
    """Return ``T_world_base`` by the chain of planar transforms in a message of ``/tf``."""
    outer, inner = (each.transform for each in message.transforms)
    return _planar(outer) @ _planar(inner)


def _planar(transform: Any) -> Pose2:
    place, turn = transform.translation, transform.rotation
    return Pose2(place.x, place.y, 2 * math.atan2(turn.z, turn.w))


def _matrix(transform: Any) -> FloatArray:
    """Return a transform as a matrix (4, 4)."""
    from scipy.spatial.transform import Rotation

    place, turn = transform.translation, transform.rotation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    T[:3, 3] = place.x, place.y, place.z
    return T


def _scan_points(scan: Any) -> FloatArray:
    """Return the measured points (n, 3) of a ``LaserScan`` in frame ``laser`` [m]."""
    angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    measured = np.isfinite(scan.ranges)
    r, angles = scan.ranges[measured].astype(np.float64), angles[measured]
    return np.stack([r * np.cos(angles), r * np.sin(angles), np.zeros_like(r)], axis=1)


RRD = RecordingFormat(write=write, suffix=".rrd")
