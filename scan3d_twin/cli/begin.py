"""How a run begins: with its folder and a first line, before the slow imports."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scan3d_twin.cli.output import say
from scan3d_twin.run.folder import claim_folder, default_folder, release_folder
from scan3d_twin.run.settings import REAL_SCENE


@contextmanager
def begun(scene: str, out: Path | None) -> Iterator[Path]:
    """Claim the folder ``out`` for a run in ``scene`` and say so; None makes one under ``runs``.

    The folder is removed again if nothing is written to it.

    Raises:
        FileError: It cannot be written, or something is in it already.
    """
    folder = claim_folder(default_folder(scene) if out is None else out)
    try:
        what = "with the real robot" if scene == REAL_SCENE else scene
        say(f"digitising {what} into {folder}")
        yield folder
    finally:
        release_folder(folder)
