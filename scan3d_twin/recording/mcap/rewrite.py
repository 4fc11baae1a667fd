"""Replaces a session file by a new one to be written to, and keeps the old one as a backup."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Metadata

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap.decode import decode_message
from scan3d_twin.recording.mcap.file import McapFile, RecordingError
from scan3d_twin.recording.mcap.recovering_reader import RawMessage, is_written, read_contents
from scan3d_twin.recording.names import PART, RECORDS, SESSION_FILE
from scan3d_twin.recording.session_log import MARK


@dataclass(frozen=True)
class Reopened:
    """A session file reopened for writing.

    Attributes:
        file: The new file, with the content of the old one up to its last mark.
        old: Former path of the old file.
        backup: Path of the old file now.
    """

    file: McapFile
    old: Path
    backup: Path

    def restore_old(self) -> None:
        """Delete the new file and restore the old one."""
        self.file.sink.close()
        self.file.sink.path.unlink(missing_ok=True)
        os.replace(self.backup, self.old)


def reopen(
    path: Path,
    wall: Callable[[], float],
    *,
    whole: bool = False,
    content: Iterable[RawMessage | Metadata] | None = None,
) -> Reopened:
    """Begin a new unfinished session file with the content of the one at ``path``.

    At every moment one of the two is complete in the folder.

    Args:
        path: The session file.
        wall: Returns the computer's time [s]; only differences count.
        whole: Also copy what follows the last mark: the drive towards an unfinished view.
        content: What to copy instead of the content that the index or a scan gives.

    Raises:
        FileError: The file is not the one that its run goes on with, a run is writing to it, it
            cannot be read, or the disk is full.
    """
    _require_current(path)
    if is_written(path):
        raise FileError(f"a running program is writing to {path}; stop it first")

    # Copy the content
    copy = path.with_name(f".{SESSION_FILE}.copy")
    copy.unlink(missing_ok=True)
    file = McapFile(copy, wall)
    try:
        if content is None:
            content = read_contents(path) if whole else read_to_last_mark(path)
        for each in content:
            copy_record(each, file)
        file.flush(0.0)
        file.sink.sync()
        backup = back_up(path)
    except BaseException as error:
        file.sink.close()
        copy.unlink(missing_ok=True)
        if isinstance(error, RecordingError):
            raise error.before_change(path) from None
        raise

    # Replace the old file
    file.sink.rename(path.with_name(SESSION_FILE + PART))
    if path.name == SESSION_FILE:
        path.unlink()
    return Reopened(file, path, backup)


def _require_current(path: Path) -> None:
    """Check that ``path`` is the file that takes the place of the others of its run.

    Raises:
        FileError: It is a backup, or an unfinished file continues it: either would be replaced.
    """
    if path.name not in (SESSION_FILE, SESSION_FILE + PART):
        raise FileError(
            f"{path} is a backup or a copy, not the {SESSION_FILE} of its run: to change the run, "
            f"name its folder, {path.parent}; to use this file, move it to a folder of its own as "
            f"{SESSION_FILE}"
        )
    if path.name == SESSION_FILE and (part := path.with_name(SESSION_FILE + PART)).exists():
        raise FileError(f"{part} continues {path}: name their folder, {path.parent}")


def read_to_last_mark(path: Path, *topics: str) -> Iterator[RawMessage | Metadata]:
    """Yield the content up to the last finished view or plan.

    Args:
        path: The session file.
        topics: Topics to yield besides the records; all if none is named.
    """
    pending: list[RawMessage | Metadata] = []
    for each in read_contents(path, *(topics and (*topics, RECORDS))):
        pending.append(each)
        if is_mark(each):
            yield from pending
            pending.clear()


def is_mark(each: RawMessage | Metadata) -> bool:
    """Return whether ``each`` is a mark: the state recorded before it is consistent."""
    if isinstance(each, Metadata) or each.topic != RECORDS:
        return False
    kind: str = decode_message(each).kind
    return kind == MARK


def copy_record(each: RawMessage | Metadata, file: McapFile) -> None:
    """Write a record of one file to another ``file``, unchanged."""
    if isinstance(each, Metadata):
        file.metadata(each.name, each.metadata)
    else:
        file.write_bytes(each.topic, each.name, each.nanoseconds, each.data, latched=each.latched)


def back_up(path: Path) -> Path:
    """Link the file at ``path`` as ``session.1.mcap`` or the next free name; return that path.

    Raises:
        FileError: The backup cannot be written.
    """
    stem, rest = path.name.split(".", 1)
    number = 1
    while os.path.lexists(backup := path.with_name(f"{stem}.{number}.{rest}")):
        number += 1
    try:
        try:
            os.link(path, backup)
        except OSError:  # a file system without links, such as that of a memory stick
            with path.open("rb") as old, backup.open("xb") as new:
                _copy_whole(old, new, backup)
    except OSError as error:
        raise FileError(f"cannot write {backup}: {error.strerror or error}") from error
    return backup


def _copy_whole(old: IO[bytes], new: IO[bytes], path: Path) -> None:
    """Copy ``old`` to ``new``, the file at ``path``, which is removed if it does not fit."""
    try:
        shutil.copyfileobj(old, new)
        new.flush()
    except OSError:
        path.unlink()
        raise


def find_latest_backup(folder: Path) -> Path:
    """Return the latest backup of the session in ``folder``.

    Raises:
        FileError: There is no backup.
    """
    found: dict[int, Path] = {}
    for path in folder.glob("session.*.mcap*"):
        number = path.name.split(".")[1]
        if number.isdigit():
            found[int(number)] = path
    if not found:
        raise FileError(f"nothing to take back in {folder}: no session.N.mcap")
    return found[max(found)]
