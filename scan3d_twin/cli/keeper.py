"""What watches a run from outside: it keeps each finished view and measures the planner."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from scan3d_twin.cli.progress import Progress
from scan3d_twin.core.hal import DriveBase
from scan3d_twin.core.motion import travelled
from scan3d_twin.core.observer import Command
from scan3d_twin.core.planning import Planner
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, ScanLine
from scan3d_twin.recording.folder import write_file
from scan3d_twin.recording.settings import Settings, settings_toml
from scan3d_twin.recording.views import view_bytes, view_path


class TimedPlanner:
    """A planner that knows how long it thought [s]."""

    def __init__(self, planner: Planner) -> None:
        self.seconds = 0.0
        self._planner = planner

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``."""
        started = time.perf_counter()
        try:
            return self._planner.plan(session, rng)
        finally:
            self.seconds += time.perf_counter() - started


class Odometer:
    """The way of a base since it was opened; to be read before the base forgets its odometry."""

    def __init__(self, base: DriveBase) -> None:
        self.path, self.turn = 0.0, 0.0
        self._base = base
        self._stamp = 0.0

    def read(self) -> None:
        """Add the way since the last reading to ``path`` [m] and ``turn`` [rad]."""
        samples = self._base.odometry_since(self._stamp)
        if not samples:
            return
        path, turn = travelled(samples)
        self.path, self.turn = self.path + path, self.turn + turn
        self._stamp = samples[-1].stamp


class Keeper:
    """Keeps each finished view on disk and the last session at hand, and tells the progress."""

    def __init__(
        self, folder: Path, settings: Settings, progress: Progress, odometer: Odometer
    ) -> None:
        self.session: Session | None = None
        self._odometer = odometer
        self._folder = folder
        self._settings = settings
        self._progress = progress

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self._progress.event(text)

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""
        self._progress.line()

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session
        self._odometer.read()
        index = len(session.views) - 1
        if index == 0:
            write_file(self._folder / "config.toml", settings_toml(self._settings))
        write_file(view_path(self._folder, index), view_bytes(session.views[index]))
        self._progress.view(session)

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session
        self._progress.plan(session)

    def command(self) -> Command:
        """See ``Observer``: Ctrl-C is the only button here, and it stops at once."""
        return "go"
