"""What watches a run from outside: it keeps each finished view and tells the progress."""

from __future__ import annotations

from pathlib import Path

from scan3d_twin.cli.progress import Progress
from scan3d_twin.core.observer import Command
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine
from scan3d_twin.recording.folder import write_file
from scan3d_twin.recording.image import NONE
from scan3d_twin.recording.settings import Settings, settings_toml
from scan3d_twin.recording.views import view_bytes, view_path


class Keeper:
    """Keeps each finished view on disk, spares memory if wanted and tells the progress.

    To compress the files waits for the end of the run, when they are written once more.
    """

    def __init__(self, folder: Path, settings: Settings, progress: Progress) -> None:
        self._folder = folder
        self._settings = settings
        self._progress = progress
        self._described = False

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self._progress.event(text)

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""
        self._progress.line()

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        index = len(session.views) - 1
        if not self._described:
            write_file(self._folder / "config.toml", settings_toml(self._settings))
            self._described = True
        write_file(view_path(self._folder, index), view_bytes(session.views[index], NONE))
        if session.config.spare == "memory":
            session.fold()
        self._progress.view(session)

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self._progress.plan(session)

    def command(self) -> Command:
        """See ``Observer``: Ctrl-C is the only button here, and it stops at once."""
        return "go"
