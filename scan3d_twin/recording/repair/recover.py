"""Repairs a session file that was cut off or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.records import Metadata

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session
from scan3d_twin.recording.load import decode_record, find_session_file, load_session, read_options
from scan3d_twin.recording.mcap import cdr
from scan3d_twin.recording.mcap.recovering_reader import (
    RawMessage,
    is_finished,
    is_sound,
    is_written,
)
from scan3d_twin.recording.mcap.rewrite import reopen
from scan3d_twin.recording.mcap.salvage import Salvage, salvage
from scan3d_twin.recording.names import RECORDS, SESSION_FILE
from scan3d_twin.recording.recorder import finish_file
from scan3d_twin.recording.repair.salvage_session import SalvagedLog
from scan3d_twin.recording.session_log import Mark, Record, SessionLog, SessionState
from scan3d_twin.run.settings import RunConfig, Settings, settings_toml

UNKNOWN = "unknown"
"""Name of the scene where the settings are lost."""


@dataclass(frozen=True)
class Recovery:
    """What a repair changed.

    Attributes:
        path: The session file now.
        backup: The old file; None if it was complete and nothing was done.
        before: Number of views that could be read before.
        after: Number of views that can be read now.
        recorded: Number of views that the run recorded, as far as its log is left.
        lost_messages: Number of messages in damaged parts; None where nothing states it.
        lost_settings: Whether the options of the run were lost and are guessed.
    """

    path: Path
    backup: Path | None
    before: int
    after: int
    recorded: int
    lost_messages: int | None = 0
    lost_settings: bool = False


def recover_session(folder: Path, wall: Callable[[], float]) -> Recovery:
    """Write a complete session file from one that was cut off or damaged, and keep the old one.

    Args:
        folder: Folder of the run.
        wall: Returns the computer's time [s]; only differences count.

    Raises:
        FileError: There is no session, a run is writing to it, nothing is left of it, or less would
            be left of it than can be read now.
    """
    # Leave a complete file alone
    path = find_session_file(folder)
    if is_written(path):
        raise FileError(f"a running program is writing to {path}; stop it first")
    before, sound = _count_views(path), is_finished(path) and is_sound(path)
    if sound and before:
        return Recovery(path, None, before, before, before)

    # Read what is left
    found = salvage(path)
    best = max(_readings(found), key=lambda each: each.worth)
    if sound and not best.views:
        return Recovery(path, None, 0, 0, 0)
    if best.views < before:
        raise FileError(
            f"{path} is damaged, but {before} views can be read as it is, and only {best.views} "
            "after a repair: it stays as it was"
        )
    if not found.chunks:
        raise FileError(f"nothing is left of {path}: no part of it can be read")

    # Write it to a new file
    metadata, lost_settings = _repaired_metadata(found, best.session)
    reopened = reopen(path, wall, content=best.content(metadata))
    if best.session is not None and best.rewritten:
        best.append_session(reopened.file.write)
    finish_file(reopened.file, path.with_name(SESSION_FILE))
    return Recovery(
        path.with_name(SESSION_FILE),
        reopened.backup,
        before,
        best.views,
        max(best.recorded, before),
        found.lost_messages,
        lost_settings,
    )


def _count_views(path: Path) -> int:
    """Return how many views can be read from the file at ``path`` as it is."""
    try:
        return len(load_session(path).session.views)
    except FileError:
        return 0


class _Reading:
    """The sound chunks of a file read in one order."""

    def __init__(self, found: Salvage, chunks: tuple[int, ...]) -> None:
        self._found, self._chunks = found, chunks
        log = SalvagedLog(self._records())
        self.mark = log.mark or Mark()
        salvaged = log.session()
        complete, broken = self._replay()
        gaps = broken or found.lost_messages != 0  # else a kill cut off an unfinished change
        self.recorded = log.expected if gaps else _views(complete)
        self.rewritten = gaps and _views(complete) < _views(salvaged)
        self.session: Session | None = salvaged if self.rewritten else complete

    @property
    def views(self) -> int:
        """Number of views."""
        return _views(self.session)

    @property
    def worth(self) -> tuple[int, bool, bool]:
        """What makes one reading better than another."""
        ended = self.session is not None and bool(self.session.stop_reason)
        return self.views, ended, not self.rewritten

    def content(self, metadata: list[Metadata]) -> Iterator[RawMessage | Metadata]:
        """Yield what is to be copied; the session log only if it is complete."""
        yield from metadata
        for each in self._found.read(self._chunks):
            if not (self.rewritten and each.topic == RECORDS):
                yield each

    def append_session(self, write: Callable[..., None]) -> None:
        """Write the session as a new log: first as it went on, then as it ended."""
        assert self.session is not None
        log, stamp = SessionLog(), self.mark.stamp
        for state in (replace(self.session, stop_reason=""), self.session):
            for kind, number, packed in log.changes(state, self.mark):
                write(RECORDS, stamp, cdr.encode_record(stamp, kind, number, packed))

    def _records(self) -> Iterator[Record]:
        for each in self._found.read(self._chunks):
            if each.topic == RECORDS:
                try:
                    yield decode_record(each)
                except FileError:
                    continue

    def _replay(self) -> tuple[Session | None, bool]:
        """Return the session of a log without gaps, and whether there are some."""
        state = SessionState()
        try:
            for record in self._records():
                state.apply(record)
        except FileError:
            return None, True
        return state.session, False


def _readings(found: Salvage) -> list[_Reading]:
    """Return the readings in the order of the file, and in that of time if it is another."""
    return [_Reading(found, order) for order in dict.fromkeys((found.chunks, found.in_time))]


def _views(session: Session | None) -> int:
    return 0 if session is None else len(session.views)


def _repaired_metadata(found: Salvage, session: Session | None) -> tuple[list[Metadata], bool]:
    """Return the metadata with valid settings, and whether these had to be guessed."""
    # Keep valid settings
    if any(_holds_settings(each, found.path) for each in found.metadata):
        return list(found.metadata), False
    if session is None:
        return list(found.metadata), False

    # Guess them from the session
    others = [each for each in found.metadata if each.name != "settings"]
    run = RunConfig(scene=UNKNOWN, seed=session.seed)
    guessed = {"name": UNKNOWN, "toml": settings_toml(Settings(run, session.config))}
    return [*others, Metadata("settings", guessed)], True


def _holds_settings(each: Metadata, path: Path) -> bool:
    try:
        return each.name == "settings" and read_options(each.metadata, path) is not None
    except FileError:
        return False
