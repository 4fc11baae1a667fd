"""Pause, continue and stop by another program, in lines on standard input."""

from __future__ import annotations

import signal
import sys
import threading
from typing import IO, TYPE_CHECKING

from scan3d_twin.cli.output import say
from scan3d_twin.core.errors import ConfigError

if TYPE_CHECKING:
    from scan3d_twin.viz.served.live import LiveView

PAUSE, CONTINUE, STOP, LEAVE = "pause", "continue", "stop", "leave"
"""The commands, a line each: to leave is not to keep the live view when the run is over."""


class RemoteCommands:
    """Obeys the lines of a stream in a thread of its own.

    A stop is the interrupt that Ctrl-C is, sent once, so that nothing interrupts the saving. The
    end of the stream is a stop too, and to leave: the run ends with the program that started it,
    however that one ended, and no robot drives on without it.
    """

    def __init__(self, stream: IO[str] | None = None) -> None:
        """Begin to read ``stream``, by default standard input.

        Raises:
            ConfigError: Standard input is closed.
        """
        self._lock = threading.Lock()
        self._view: LiveView | None = None
        self._pausing = self._leaving = self._stopped = False
        source = _open_input() if stream is None else stream
        self._thread = threading.Thread(target=self._obey, args=(source,), daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Wait until the stream has ended and is obeyed."""
        self._thread.join()

    def attach(self, view: LiveView) -> None:
        """Let ``view`` take the commands; those that came before are not lost."""
        with self._lock:
            self._view = view
            if self._pausing:
                view.set_pause(True)
            if self._leaving:
                view.leave()

    def _obey(self, stream: IO[str]) -> None:
        for line in stream:
            command = line.strip()
            if command == STOP:
                self._stop()
            elif command == LEAVE:
                self._leave()
            elif command in (PAUSE, CONTINUE):
                self._set_pause(command == PAUSE)
            elif command:
                known = ", ".join((PAUSE, CONTINUE, STOP, LEAVE))
                say(f"unknown command {command!r}; known: {known}")
        self._leave()
        self._stop()

    def _stop(self) -> None:
        """Interrupt the run, if that was not done before."""
        if not self._stopped:
            self._stopped = True
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    def _leave(self) -> None:
        with self._lock:
            self._leaving = True
            if self._view is not None:
                self._view.leave()

    def _set_pause(self, wanted: bool) -> None:
        with self._lock:
            self._pausing = wanted
            if self._view is not None:
                self._view.set_pause(wanted)


def _open_input() -> IO[str]:
    """Open standard input once more: ``sys.stdin`` is locked by who reads it as Python ends."""
    if sys.stdin is None:
        raise ConfigError("--commands reads standard input, which is closed")
    return open(sys.stdin.fileno(), encoding="utf-8", errors="replace", closefd=False)
