"""Changes to a recorded session; a backup beside it lets ``undo_last_change`` restore it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.mapping.loop_closure import Alignment, align, apply_alignment
from scan3d_twin.core.session import Session
from scan3d_twin.recording.load import RecordedRun, find_session_file, load_session
from scan3d_twin.recording.mcap import cdr
from scan3d_twin.recording.mcap.recovering_reader import is_written
from scan3d_twin.recording.mcap.rewrite import back_up, find_latest_backup, reopen
from scan3d_twin.recording.names import RECORDS, SESSION_FILE
from scan3d_twin.recording.recorder import finish_file, write_display
from scan3d_twin.recording.session_log import SessionLog


def remove_view(session: Session, index: int) -> Session:
    """Return ``session`` without the view ``index``, the other views placed again.

    They are aligned all at once if the run did so, else registered one after the other.

    Raises:
        ConfigError: There is no such view, or it is the only one.
    """
    # Check that it can go
    if not 0 <= index < len(session.views):
        raise ConfigError(
            f"there is no view {index}: the run has {len(session.views)}, counted from 0"
        )
    if len(session.views) == 1:
        raise ConfigError("the only view cannot be dropped")

    # Align the others all at once
    if session.config.alignment.mode != "off":
        return align(session, leave_out=[index])

    # Or register one after another
    views = tuple(k for k in range(len(session.views)) if k != index)
    poses = tuple(session.views[k].T_world_scan for k in views)
    rest = apply_alignment(session, Alignment(views, poses, np.zeros((len(views), 3)), (), ()))
    again = replace(rest, views=())
    for view in rest.views:
        again = integrate(again, view.observation)
    return again


def drop_view(folder: Path, index: int, wall: Callable[[], float]) -> RecordedRun:
    """Drop the view ``index`` from the session in ``folder`` and return the new session.

    Args:
        folder: Folder of the run.
        index: Index of the view, counted from 0.
        wall: Returns the computer's time [s]; only differences count.

    Raises:
        ConfigError: As for ``remove_view``.
        FileError: There is no session, a run is writing to it, or the disk is full.
    """
    # Remove the view from the session
    recorded = load_session(folder)
    session, mark = remove_view(recorded.session, index), recorded.mark

    # Append the changes to the file
    reopened = reopen(recorded.path, wall, whole=True)
    log = SessionLog(recorded.session)
    for state in (replace(session, stop_reason=""), session):
        for kind, number, packed in log.changes(state, mark):
            record = cdr.encode_record(mark.stamp, kind, number, packed)
            reopened.file.write(RECORDS, mark.stamp, record)
    write_display(reopened.file, mark.stamp, session)
    finish_file(reopened.file, recorded.path.with_name(SESSION_FILE))
    return load_session(folder)


def undo_last_change(folder: Path) -> RecordedRun:
    """Undo the last change of the session in ``folder``; a second call redoes it.

    Raises:
        FileError: There is no change to undo, or a run is writing to the session.
    """
    path, backup = find_session_file(folder), find_latest_backup(folder)
    if is_written(path):
        raise FileError(f"a running program is writing to {path}; stop it first")
    back_up(path)
    name = SESSION_FILE + backup.name.split(".mcap", 1)[1]
    try:
        if path.name != name:
            path.unlink()
        backup.replace(path.with_name(name))
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    return load_session(folder)
