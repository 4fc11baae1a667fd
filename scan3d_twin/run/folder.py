"""The folder of a run: claimed before the robot moves, every file in it written atomically."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from scan3d_twin.core.errors import FileError

RUNS = Path("runs")
"""Folder of the runs for which none is stated."""


def claim_folder(path: Path) -> Path:
    """Make the folder ``path`` for a new run and return it.

    Raises:
        FileError: The folder cannot be made or written, or is not empty.
    """
    probe = path / ".writable"
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise FileError(f"the folder {path} is not empty; choose a new or empty one")
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise FileError(f"cannot write to {path}: {reason}; choose another folder") from error
    return path


def find_free_folder(path: Path) -> Path:
    """Return ``path``, or the first of ``path-2``, ``path-3`` ... that does not exist."""
    candidate, number = path, 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def default_folder(scene: str, parent: Path = RUNS) -> Path:
    """Return a new folder in ``parent`` for a run in ``scene``, named by the time of day."""
    return find_free_folder(parent / f"{scene}-{datetime.now():%Y%m%d-%H%M%S}")


def readable(path: Path | str) -> str:
    """Return ``path`` as text for pages and tables: what is not UTF-8 in it becomes U+FFFD."""
    return os.fsencode(path).decode("utf-8", "replace")


def release_folder(path: Path) -> None:
    """Remove the folder ``path`` if nothing was written to it."""
    try:
        path.rmdir()
    except OSError:
        return


def write_file(path: Path, content: bytes | str) -> None:
    """Write ``content`` to ``path`` atomically: the whole file or nothing.

    Raises:
        FileError: The disk is full, or the folder is gone or read-only.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        with fresh_part(path) as part:
            part.write_bytes(data)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error


def write_inside(folder: Path, path: Path, content: bytes | str) -> None:
    """Write ``content`` to ``path`` in ``folder``, which may come from someone else.

    Raises:
        FileError: As ``write_file``; or a folder between the two is a link that leads elsewhere.
    """
    require_own_folders(folder, path.parent)
    write_file(path, content)


def require_own_folders(folder: Path, below: Path) -> None:
    """Check that no folder on the way from ``folder`` to the folder ``below`` is a link.

    Raises:
        FileError: One is; what is written or deleted there would be someone else's.
    """
    for place in (below, *below.parents):
        if place == folder:
            return
        if place.is_symlink():
            raise FileError(f"{place} is a link to another place; remove it to go on")


@contextmanager
def fresh_part(path: Path) -> Iterator[Path]:
    """Give the path of a new, empty file beside ``path``, which replaces it at the end.

    It is opened exclusively under an unforeseeable name, so that no file or link that lies there
    is written through; after an error it is removed.

    Raises:
        OSError: The file cannot be made or renamed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{secrets.token_hex(8)}.part")
    os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    try:
        yield part
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
