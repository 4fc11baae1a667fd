"""A run as a child process, exactly as the command line would start it."""

from __future__ import annotations

import subprocess
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Literal

from scan3d_twin.api.run import EVALUATING, SAVING
from scan3d_twin.api.watch import STAYS
from scan3d_twin.cli.console.form import PROGRAM
from scan3d_twin.cli.exit_codes import INTERRUPTED
from scan3d_twin.cli.remote import CONTINUE, LEAVE, PAUSE, STOP
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.viz.served.live import ADDRESS, ANNOUNCED

State = Literal[
    "starting", "running", "pausing", "paused", "stopping", "saving", "finished", "stopped",
    "failed",
]  # fmt: skip
"""State of a run: pausing until the current view is finished, stopping the wheels."""
OVER: tuple[State, ...] = ("finished", "stopped", "failed")
STEERABLE: tuple[State, ...] = ("running", "pausing", "paused")
"""States in which there is a live view, and the run can be paused."""
_STATES: dict[str, State] = {
    ANNOUNCED["pausing"]: "pausing",
    ANNOUNCED["paused"]: "paused",
    ANNOUNCED["running"]: "running",
    ANNOUNCED["stopped"]: "stopping",
    EVALUATING: "saving",
    SAVING: "saving",
}
"""State that begins with a line of the run."""
KEPT_LINES = 300
"""Number of lines of progress that are kept."""
ERROR = "error: "


@dataclass(frozen=True)
class RunSnapshot:
    """A run as the page shows it.

    Attributes:
        command: What was started, as one would type it.
        kind: ``sim`` or ``real``.
        state: How it stands.
        lines: The latest lines of its progress.
        live_view: Address of its live view; empty where there is none, or no more.
        error: The one-line error that ended it; empty for none.
    """

    command: str
    kind: str
    state: State
    lines: tuple[str, ...]
    live_view: str
    error: str


class RunProcess:
    """A child process ``twin sim`` or ``twin real`` that obeys commands.

    It has a session of its own, so that a Ctrl-C in the terminal of the console reaches it once,
    through the console; and it ends with the console, see ``RemoteCommands``.
    """

    def __init__(self, arguments: Sequence[str], command: str) -> None:
        """Start ``twin`` with ``arguments``; ``command`` is what is shown of them."""
        self._command, self._kind = command, arguments[0]
        self._lock = threading.Lock()
        self._state: State = "starting"
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._live_view, self._error = "", ""
        self._process = subprocess.Popen(
            [*PROGRAM, *arguments], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, encoding="utf-8", errors="replace", start_new_session=True,
        )  # fmt: skip
        assert self._process.stderr is not None
        self._reader = threading.Thread(
            target=self._follow, args=(self._process.stderr,), daemon=True
        )
        self._reader.start()

    @property
    def is_over(self) -> bool:
        """Whether the robot is at rest and the files are saved; the live view may be open still."""
        with self._lock:
            return self._state in OVER

    def snapshot(self) -> RunSnapshot:
        """Return the run as it stands."""
        with self._lock:
            return RunSnapshot(
                self._command, self._kind, self._state, tuple(self._lines), self._live_view,
                self._error,
            )  # fmt: skip

    def pause(self, wanted: bool) -> None:
        """Let the run wait when its current view is finished, or go on.

        Raises:
            ConfigError: It cannot be paused now.
        """
        with self._lock:
            if self._state not in STEERABLE:
                raise ConfigError(f"the run is {self._state}: there is nothing to pause")
        self._send(PAUSE if wanted else CONTINUE)

    def stop(self) -> None:
        """Stop the wheels at once and let the run save what it has, unless it does so already."""
        with self._lock:
            if self._state in ("stopping", "saving", *OVER):
                return
            self._state = "stopping"
        self._send(STOP)

    def end(self) -> None:
        """Stop the run, close its live view, and wait until it has saved all and ended."""
        self.stop()
        self._send(LEAVE)
        self._process.wait()
        self._reader.join()

    def _send(self, command: str) -> None:
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # it has ended just now
            self._process.stdin.write(f"{command}\n")
            self._process.stdin.flush()

    def _follow(self, lines: IO[str]) -> None:
        assert self._process.stdin is not None
        with lines:
            for line in lines:
                with self._lock:
                    self._hear(line.rstrip("\n"))
        code = self._process.wait()
        with suppress(OSError):  # a command that it no longer read
            self._process.stdin.close()
        with self._lock:
            self._end(code)

    def _hear(self, line: str) -> None:
        """Take in a line of the run's progress."""
        if line.startswith(ADDRESS):  # not among the lines: who sees it can steer the run
            self._live_view = line.removeprefix(ADDRESS)
            self._state = "running" if self._state == "starting" else self._state
            return
        self._lines.append(line)
        if line.startswith(ERROR):
            self._error = line.removeprefix(ERROR)
        elif line.endswith(STAYS):
            self._state = next(each for each in OVER if line.startswith(each))
        elif line in _STATES:
            self._state = _STATES[line]

    def _end(self, code: int) -> None:
        """Take in the exit ``code`` of the process."""
        self._live_view = ""
        if code == 0:
            self._state, self._error = "finished", ""
        elif code == INTERRUPTED:
            self._state, self._error = "stopped", ""
        else:
            self._state = "failed"
            self._error = self._error or f"it ended with exit code {code}; see its lines"
