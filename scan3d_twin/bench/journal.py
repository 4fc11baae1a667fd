"""The journal: one line per finished task, written at once, so that a killed bench can resume.

A line is complete with its line feed; an incomplete last line, left by a killed bench, is ignored.
The last line of a task counts.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

from scan3d_twin.bench.record import Record, from_row, to_json
from scan3d_twin.core.errors import FileError
from scan3d_twin.run.strict_json import parse_json

JOURNAL_PATTERN = "journal*.jsonl"


def journal_path(folder: Path, shard: tuple[int, int]) -> Path:
    """Return the journal's path of ``shard`` (number from 1, count); shards may share a folder."""
    number, count = shard
    return folder / ("journal.jsonl" if count == 1 else f"journal-{number}of{count}.jsonl")


def read_journals(paths: Iterable[Path]) -> dict[str, Record]:
    """Return the records of journals by key.

    Raises:
        FileError: A journal cannot be read, or a line other than the last is broken.
    """
    records: dict[str, Record] = {}
    for path in paths:
        for row in _rows(path):
            records[row.key] = row
    return records


def _rows(path: Path) -> list[Record]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}") from error
    lines = content.split(b"\n")[:-1]
    return [_row(path, number, line) for number, line in enumerate(lines, start=1)]


def _row(path: Path, number: int, line: bytes) -> Record:
    try:
        row: dict[str, Any] = parse_json(line)
        return from_row(row)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(
            f"{path}, line {number} is no record ({error}); remove that line to continue"
        ) from error


class Journal:
    """A journal open for appending, locked against other benches."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` and cut off an incomplete last line.

        Raises:
            FileError: The journal cannot be written, or another bench has it open.
        """
        # Create and open the file
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
            self._file = os.open(path, flags, 0o644)
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror}") from error

        # Lock it against other benches
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise FileError(
                f"another bench writes {path}; wait for it, or name another folder with --out"
            ) from None

        # Cut off an incomplete line
        self._path = path
        self._cut()

    def _cut(self) -> None:
        """Remove everything after the last line feed."""
        content = self._path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.ftruncate(self._file, whole)

    def append(self, record: Record) -> None:
        """Write ``record`` and wait until it is on the disk.

        Raises:
            FileError: The disk is full.
        """
        self._write((to_json(record) + "\n").encode())

    def _write(self, data: bytes) -> None:
        try:
            while data:
                data = data[os.write(self._file, data) :]
            os.fsync(self._file)
        except OSError as error:
            raise FileError(f"cannot write {self._path}: {error.strerror}") from error

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._file)
