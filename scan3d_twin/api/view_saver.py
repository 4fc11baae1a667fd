"""The observer that saves each finished view, so that a run that dies loses at most one."""

from __future__ import annotations

from pathlib import Path

from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.session import Session
from scan3d_twin.recording.image import NO_COMPRESSION
from scan3d_twin.recording.views import view_bytes, view_path
from scan3d_twin.run.folder import write_file, write_inside
from scan3d_twin.run.settings import Settings, settings_toml


class ViewSaver(Unobserved):
    """Writes the settings and each finished view; compresses the session if memory is short.

    The files are compressed at the end of the run, when they are written once more.
    """

    def __init__(self, folder: Path, settings: Settings) -> None:
        self._folder = folder
        self._settings = settings
        self._settings_saved = False

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        index = len(session.views) - 1
        if not self._settings_saved:
            write_file(self._folder / "config.toml", settings_toml(self._settings))
            self._settings_saved = True
        data = view_bytes(session.views[index], NO_COMPRESSION)
        write_inside(self._folder, view_path(self._folder, index), data)
        if session.config.optimize_for == "memory":
            session.compress()
