"""Session files of views that no robot of ours has recorded, and views added to a session."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.records import Metadata

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.scanning.patterns import rotate_z
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Pose2,
    RangeImage,
    ScanLine,
    read_only,
)
from scan3d_twin.recording.load import RecordedRun
from scan3d_twin.recording.mcap import cdr, ros_display, ros_records
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.recovering_reader import read_contents
from scan3d_twin.recording.mcap.rewrite import reopen
from scan3d_twin.recording.names import (
    ANGLES,
    CLOUDS,
    PART,
    RECORDS,
    SCANS,
    SESSION_FILE,
)
from scan3d_twin.recording.recorder import finish_file, write_display
from scan3d_twin.recording.session_log import Mark, SessionLog
from scan3d_twin.run.settings import Settings, settings_toml

PLACES = "places"
"""Metadata of the true places of a scanner that was set down by hand in the twin."""
PAUSE = 1.0
"""Time between two views on the clock of a session [s], in which the scanner was set down anew."""


def follow_in_time(observations: list[Observation], after: float = 0.0) -> list[Observation]:
    """Return the observations with stamps that follow each other, from ``after`` [s] on."""
    placed = []
    for each in observations:
        image = each.image
        stamps = image.stamps - float(image.stamps.min()) + after
        placed.append(replace(each, image=replace(image, stamps=read_only(stamps))))
        after = _find_end(placed[-1].image) + PAUSE
    return placed


def write_session(
    folder: Path,
    name: str,
    settings: Settings,
    session: Session,
    provenance: Mapping[str, str],
    wall: Callable[[], float],
) -> Mark:
    """Write the session file of ``session`` to ``folder``, which holds none; return its last mark.

    Args:
        folder: The run's folder.
        name: Name of the scene.
        settings: The effective settings.
        session: With at least one view; the stamps of its views follow each other.
        provenance: Versions, command and date of the program.
        wall: Returns the computer's time [s]; only differences count.

    Raises:
        FileError: The file cannot be written.
    """
    path = folder / SESSION_FILE
    file = McapFile(path.with_name(path.name + PART), wall)
    try:
        file.metadata("provenance", provenance)
        file.metadata("settings", {"name": name, "toml": settings_toml(settings)})
        mark = _append(file, None, session, Mark())
        finish_file(file, path)
    except BaseException:
        file.sink.close()
        file.sink.path.unlink(missing_ok=True)
        raise
    return mark


def append_views(
    recorded: RecordedRun,
    session: Session,
    wall: Callable[[], float],
    places: Sequence[tuple[float, Pose2]] = (),
) -> Mark:
    """Add to the file of ``recorded`` what ``session`` has more; return the last mark.

    The earlier file stays beside it, so that ``twin session undo`` takes the addition back.

    Args:
        recorded: The run.
        session: The run with more views.
        wall: Returns the computer's time [s]; only differences count.
        places: In the twin, where the scanner truly stood from which time on, see ``read_places``.

    Raises:
        FileError: The file cannot be written, or a run is writing to it.
    """
    reopened = reopen(recorded.path, wall, whole=True)
    try:
        if places:
            rows = [[start, pose.x, pose.y, pose.yaw] for start, pose in places]
            reopened.file.metadata(PLACES, {"json": json.dumps(rows)})
        mark = _append(reopened.file, recorded.session, session, recorded.mark)
        finish_file(reopened.file, recorded.path.with_name(SESSION_FILE))
    except BaseException:
        reopened.file.sink.close()
        reopened.restore_old()
        raise
    return mark


def read_places(path: Path) -> list[tuple[float, Pose2]]:
    """Return where the scanner of the twin stood by hand: since when [s], and ``T_map_base``.

    Raises:
        FileError: The file cannot be read, or the places are damaged.
    """
    text = "[]"
    for each in read_contents(path, PLACES):
        if isinstance(each, Metadata) and each.name == PLACES:
            text = each.metadata.get("json", "[]")
    try:
        rows = np.array(json.loads(text), dtype=np.float64).reshape(-1, 4)
    except (ValueError, TypeError, RecursionError):
        raise FileError(f"{path}: the places of its scanner are damaged") from None
    if not np.all(np.isfinite(rows)):
        raise FileError(f"{path}: the places of its scanner are damaged")
    return [(float(start), Pose2(*pose)) for start, *pose in rows]


def _append(file: McapFile, before: Session | None, session: Session, mark: Mark) -> Mark:
    """Write the lines, clouds and records of what ``session`` has more than ``before``."""
    # The lines and clouds of the new views
    known = 0 if before is None else len(before.views)
    for k, view in enumerate(session.views[known:], known):
        image, frames = view.observation.image, view.T_world_scan
        first = float(image.stamps.min())
        file.write("/tf", first, cdr.encode_frames(first, frames, Pose2()))
        for line, T_base_lidar in _read_lines(image):
            file.write("/tf", line.stamp, ros.encode_mount(T_base_lidar, line.stamp))
            complete = line.stamp + image.spec.line_period
            if line.elevations is not None:
                file.write(ANGLES, complete, ros_records.encode_angles(line, image.spec))
            file.write(SCANS, complete, cdr.encode_scan(line, image.spec))
        end = _find_end(image)
        file.write(CLOUDS, end, ros_display.encode_cloud(end, k, view))
        if view.registration is not None:
            placed = ros_records.encode_registration(end, k, view.registration)
            file.write("/registration", end, placed)
        mark = replace(mark, stamp=end)

    # The session, open and finished
    log = SessionLog(before)
    for state in (replace(session, stop_reason=""), session):
        for kind, index, packed in log.changes(state, mark):
            record = cdr.encode_record(mark.stamp, kind, index, packed)
            file.write(RECORDS, mark.stamp, record)
    write_display(file, mark.stamp, session)
    return mark


def _find_end(image: RangeImage) -> float:
    return float(image.stamps.max()) + max(image.spec.line_period, 0.0)


def _read_lines(image: RangeImage) -> Iterator[tuple[ScanLine, FloatArray]]:
    """Yield the lines of ``image`` in the order of time, and where the lidar was (4, 4).

    The frames ``base`` and ``scan`` are one, and the lidar turns in them.
    """
    T_scan_axis = np.eye(4) if image.T_scan_axis is None else image.T_scan_axis
    middle = image.spec.n_beams // 2
    for k in np.argsort(image.stamps, kind="stable"):
        own = None if image.elevations is None else image.elevations[k]
        stamp = float(image.stamps[k])
        assert math.isfinite(stamp)
        T_base_lidar = T_scan_axis @ rotate_z(float(image.yaws[k, middle])) @ image.T_base_lidar
        yield ScanLine(stamp, image.ranges[k], image.codes[k], own), T_base_lidar
