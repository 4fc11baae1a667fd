"""The folder of a run: claimed before the robot moves, every file in it written atomically."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

from scan3d_twin.core.errors import FileError


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


def default_folder(scene: str) -> Path:
    """Return a new folder under ``runs`` for a run in ``scene``, named by the time of day."""
    return find_free_folder(Path("runs") / f"{scene}-{datetime.now():%Y%m%d-%H%M%S}")


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
    part = path.with_name(path.name + ".part")
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
