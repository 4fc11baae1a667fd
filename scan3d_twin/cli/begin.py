"""How a run begins: with its folder and a first line, before what is slow to import."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from scan3d_twin.run.folder import claim_folder, find_free_folder, release_folder


@contextmanager
def begun(scene: str, out: Path | None) -> Iterator[Path]:
    """Claim the folder ``out`` of a run in ``scene`` and say so; None makes one under ``runs``.

    Nothing is left of it if nothing is written.

    Raises:
        FileError: It cannot be written, or something is in it already.
    """
    folder = claim_folder(default_folder(scene) if out is None else out)
    try:
        print(f"digitising {scene} into {folder}", file=sys.stderr, flush=True)
        yield folder
    finally:
        release_folder(folder)


def default_folder(scene: str) -> Path:
    """Return a new folder under ``runs`` for a run in ``scene``."""
    return find_free_folder(Path("runs") / f"{scene}-{datetime.now():%Y%m%d-%H%M%S}")
