"""Writing a new session file in place of an old one, which is kept beside it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Metadata

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.reader import RawMessage, is_written, read_contents
from scan3d_twin.recording.names import PART, RECORDS, SESSION_FILE
from scan3d_twin.recording.session_log import MARK


@dataclass(frozen=True)
class Reopened:
    """A session file that can be written to once more.

    Attributes:
        file: Holds everything of the old one up to its last mark.
        old: Where the old one was.
        backup: Where it is now.
    """

    file: McapFile
    old: Path
    backup: Path

    def take_back(self) -> None:
        """Drop the new file and put the old one in its place again."""
        self.file.sink.close()
        self.file.sink.path.unlink(missing_ok=True)
        os.replace(self.backup, self.old)


def reopen(path: Path, wall: Callable[[], float], *, whole: bool = False) -> Reopened:
    """Begin a new unfinished session file with what the one at ``path`` holds.

    At every moment one of the two is in the folder as a whole.

    Args:
        path: Of the session file.
        wall: Returns the time here [s]; only differences count.
        whole: Also what comes after its last mark: the way towards a view that was not finished.

    Raises:
        FileError: A run is writing to it, it cannot be read, or there is no room.
    """
    if is_written(path):
        raise FileError(f"{path} is being written by a run that goes on: stop that first")
    copy = path.with_name(f".{SESSION_FILE}.copy")
    copy.unlink(missing_ok=True)
    file = McapFile(copy, wall)
    try:
        for each in read_contents(path) if whole else read_to_last_mark(path):
            copy_record(each, file)
        file.flush(0.0)
        file.sink.sync()
        backup = back_up(path)
    except BaseException:
        file.sink.close()
        copy.unlink(missing_ok=True)
        raise
    file.sink.rename(path.with_name(SESSION_FILE + PART))
    if path.name == SESSION_FILE:
        path.unlink()
    return Reopened(file, path, backup)


def read_to_last_mark(path: Path, *topics: str) -> Iterator[RawMessage | Metadata]:
    """Yield what belongs to a finished view or plan; not the way that led to no other one.

    Args:
        path: Of the session file.
        topics: Which messages besides the records; all if none is named.
    """
    pending: list[RawMessage | Metadata] = []
    for each in read_contents(path, *(topics and (*topics, RECORDS))):
        pending.append(each)
        if is_mark(each):
            yield from pending
            pending.clear()


def is_mark(each: RawMessage | Metadata) -> bool:
    """Tell whether all that was recorded before ``each`` belongs together."""
    if isinstance(each, Metadata) or each.topic != RECORDS:
        return False
    kind: str = ros.typestore().deserialize_cdr(each.data, each.name).kind
    return kind == MARK


def copy_record(each: RawMessage | Metadata, file: McapFile) -> None:
    """Write what was read from one file to another."""
    if isinstance(each, Metadata):
        file.metadata(each.name, each.metadata)
    else:
        file.write_bytes(each.topic, each.name, each.nanoseconds, each.data, latched=each.latched)


def back_up(path: Path) -> Path:
    """Give the file at ``path`` a second name, ``session.1.mcap`` or the next free one; return it.

    Raises:
        FileError: It cannot be.
    """
    stem, rest = path.name.split(".", 1)
    number = 1
    while (backup := path.with_name(f"{stem}.{number}.{rest}")).exists():
        number += 1
    try:
        try:
            os.link(path, backup)
        except OSError:  # a file system without links, such as that of a memory stick
            shutil.copy2(path, backup)
    except OSError as error:
        raise FileError(f"cannot write {backup}: {error.strerror or error}") from error
    return backup


def find_latest_backup(folder: Path) -> Path:
    """Return the file that the session in ``folder`` was made from last.

    Raises:
        FileError: There is none.
    """
    found: dict[int, Path] = {}
    for path in folder.glob("session.*.mcap*"):
        number = path.name.split(".")[1]
        if number.isdigit():
            found[int(number)] = path
    if not found:
        raise FileError(f"nothing to take back in {folder}: no session.N.mcap")
    return found[max(found)]
