"""Reads session files, finished or not, back into sessions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Metadata

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2, ScanLine
from scan3d_twin.recording.checks import check_session, check_track
from scan3d_twin.recording.mcap.decode import decode_message
from scan3d_twin.recording.mcap.recovering_reader import (
    RawMessage,
    is_finished,
    is_written,
    read_contents,
)
from scan3d_twin.recording.mcap.rewrite import read_to_last_mark
from scan3d_twin.recording.names import (
    ANGLES,
    COMMANDS,
    ODOMETRY,
    PART,
    RECORDS,
    SCANS,
    SESSION_FILE,
)
from scan3d_twin.recording.session_log import Mark, Record, SessionState
from scan3d_twin.run.report import Journey, thin_track
from scan3d_twin.run.settings import Settings, build_settings
from scan3d_twin.run.toml import parse_toml


class NoViewError(FileError):
    """A session file holds no finished view."""


@dataclass(frozen=True)
class RecordedRun:
    """The content of a session file.

    Attributes:
        path: The file.
        finished: Whether the run ended by itself; otherwise it was killed, or still runs.
        running: Whether a run is writing to the file now.
        name: Name of the scene.
        settings: The effective settings.
        session: State after the last finished view or plan; ``stop_reason`` is empty for a killed
            run.
        before_end: State before the final alignment, which may drop and move views.
        mark: Time, path and pose of the robot in that state.
        provenance: Versions, command and date of the program that wrote the file.
    """

    path: Path
    finished: bool
    running: bool
    name: str
    settings: Settings
    session: Session
    before_end: Session
    mark: Mark
    provenance: Mapping[str, str]


@dataclass(frozen=True)
class Beginning:
    """What the file of a run holds that ended before its first view was finished.

    Attributes:
        path: The file.
        running: Whether a run is writing to it now.
        name: Name of the scene; empty if the file does not say it.
        settings: The effective settings, if they are there.
        provenance: Versions, command and date of the program that wrote the file.
        duration: Time of the last message on the robot's clock [s].
    """

    path: Path
    running: bool
    name: str
    settings: Settings | None
    provenance: Mapping[str, str]
    duration: float


def read_beginning(place: Path) -> Beginning:
    """Return what is known of a run without a finished view.

    Raises:
        FileError: There is no session file, it is damaged, or nothing is in it.
    """
    path = find_session_file(place)
    texts, last = {}, 0
    for each in read_contents(path):
        if isinstance(each, Metadata):
            texts[each.name] = each.metadata
        else:
            last = max(last, each.nanoseconds)
    if not texts and not last:
        raise FileError(f"{path} holds nothing of a run: no session of twin, or all is damaged")
    described = texts.get("settings")
    return Beginning(
        path=path,
        running=is_written(path),
        name="" if described is None else described.get("name", ""),
        settings=None if described is None else read_options(described, path),
        provenance=texts.get("provenance", {}),
        duration=last / 1e9,
    )


def run_folder(run: Path) -> Path:
    """Return the folder of a ``run`` that is named by its folder or its session file."""
    return run if run.is_dir() else run.parent


def find_session_file(place: Path) -> Path:
    """Return the session file of the run in the folder ``place``, or ``place`` if it is a file.

    An unfinished file takes precedence over the finished one that it continues.

    Raises:
        FileError: There is no session file.
    """
    if place.is_file():
        return place
    for name in (SESSION_FILE + PART, SESSION_FILE):
        if (place / name).is_file():
            return place / name
    raise FileError(f"no session in {place}: a run's folder holds a {SESSION_FILE}")


def load_session(place: Path) -> RecordedRun:
    """Return the session recorded in the folder ``place``, or in the file ``place`` itself.

    An unfinished file is read up to its last complete record, and not changed.

    Raises:
        FileError: There is no session file, no view was finished in it, or it is damaged.
    """
    # Replay the session log
    path = find_session_file(place)
    texts, state = {}, SessionState()
    for each in read_contents(path, RECORDS):
        if isinstance(each, Metadata):
            texts[each.name] = each.metadata
        else:
            try:
                state.apply(decode_record(each))
            except FileError as error:
                raise FileError(f"{path}: {error}") from None
    if not (state.session and state.session.views and state.mark and "settings" in texts):
        raise NoViewError(f"{path} holds no finished view: there is nothing to load or resume")

    # Check it
    try:
        check_session(state.session)
        check_session(state.open_session or state.session)
    except FileError as error:
        raise FileError(f"{path} holds a session that cannot be right: {error}") from None

    # Return it with its settings
    described = texts["settings"]
    return RecordedRun(
        path=path,
        finished=is_finished(path),
        running=is_written(path),
        name=described.get("name", ""),
        settings=read_options(described, path),
        session=state.session,
        before_end=state.open_session or state.session,
        mark=state.mark,
        provenance=texts.get("provenance", {}),
    )


def read_options(described: Mapping[str, str], source: object) -> Settings:
    """Return the effective settings that the metadata of a session file describe.

    Raises:
        FileError: They are damaged; ``source`` says in messages where they come from.
    """
    try:
        return build_settings([parse_toml(described.get("toml", ""), f"the settings of {source}")])
    except ConfigError as error:
        raise FileError(f"the settings of {source} are damaged: {error}") from None


def read_commands(path: Path) -> Iterator[tuple[float, float, float]]:
    """Yield stamp [s], speed [m/s] and turn rate [rad/s] of the commands sent to the base.

    In the order of sending, up to the last mark.
    """
    for each in read_to_last_mark(path, COMMANDS):
        if isinstance(each, RawMessage) and each.topic == COMMANDS:
            twist = decode_message(each).twist
            yield each.nanoseconds / 1e9, float(twist.linear.x), float(twist.angular.z)


def read_last_odometry(path: Path) -> tuple[float, Pose2]:
    """Return stamp [s] and pose ``T_odom_base`` of the last sample, also after the last mark.

    Raises:
        FileError: The file holds no odometry, or damaged one.
    """
    last = None
    for each in read_contents(path, ODOMETRY):
        if isinstance(each, RawMessage):
            last = each
    if last is None:
        raise FileError(f"{path} holds no odometry")
    ((stamp, x, y, yaw),) = _checked_track([_odometry_of(last)], path).tolist()
    return stamp, Pose2(x, y, yaw)


def read_track(path: Path) -> FloatArray:
    """Return all odometry: stamp [s], x, y [m] and yaw [rad] (n, 4) in ``odom``.

    Raises:
        FileError: It is damaged.
    """
    messages = (each for each in read_contents(path, ODOMETRY) if isinstance(each, RawMessage))
    result = _checked_track([_odometry_of(each) for each in messages], path)
    result[:, 3] = np.unwrap(result[:, 3])
    return result


def _odometry_of(each: RawMessage) -> tuple[float, float, float, float]:
    """Return stamp [s], x, y [m] and yaw [rad] of a message of the odometry."""
    pose = decode_message(each).pose.pose
    yaw = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    return each.nanoseconds / 1e9, pose.position.x, pose.position.y, yaw


def _checked_track(rows: list[tuple[float, float, float, float]], path: Path) -> FloatArray:
    track = np.array(rows, dtype=np.float64).reshape(-1, 4)
    try:
        check_track(track)
    except FileError as error:
        raise FileError(f"{path}: {error}") from None
    return track


def read_journey(run: RecordedRun) -> Journey:
    """Return the journey up to the mark of ``run``."""
    track = read_track(run.path)
    until = track[track[:, 0] <= run.mark.stamp]
    return Journey(run.mark.path, run.mark.turn, run.mark.stamp, thin_track(until))


def read_lines(path: Path) -> Iterator[ScanLine]:
    """Yield all scan lines, also those of panoramas and unfinished sweeps.

    With the precision of the ROS messages: nanoseconds, distances to 7 digits. The sweeps of
    views are stored exactly elsewhere in the file.
    """
    angles = None
    for each in read_contents(path, SCANS, ANGLES):
        if not isinstance(each, RawMessage):
            continue
        scan = decode_message(each)
        if each.topic == ANGLES:  # of the line that follows
            angles = scan
            continue
        stamp = scan.header.stamp.sec + scan.header.stamp.nanosec / 1e9
        ranges, codes = scan.ranges.astype("float64"), scan.intensities.astype("int64")
        own = (None, None) if angles is None else (angles.elevations, angles.times)
        yield ScanLine(stamp, ranges, codes, *own)
        angles = None


def decode_record(each: RawMessage) -> Record:
    """Return the record of the session log in a message."""
    message = decode_message(each)
    return message.kind, message.index, (message.json, message.data.tobytes())
