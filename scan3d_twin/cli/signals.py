"""The signals that end the program: all are an interrupt, after which the run is saved."""

from __future__ import annotations

import math
import signal
import sys
import time
from types import FrameType
from typing import IO

from scan3d_twin.cli.output import discard

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Ctrl-C, a polite ``kill``, a terminal or an ssh connection that is closed, and Ctrl-\\."""
KEPT_IGNORED = (signal.SIGHUP, signal.SIGQUIT)
"""Signals that stay ignored where the program is started so, as ``nohup`` does."""
REPEATED = 2.0
"""Time within which the same end is announced twice [s]: a closed connection sends SIGHUP from the
kernel and from the shell, and ``timeout`` sends SIGTERM to the program and to its group;
assumption. Later ones, and a second Ctrl-C, interrupt the saving."""


class _Interrupt(KeyboardInterrupt):
    """One of the signals.

    CPython ends ``python -m`` by SIGINT, whatever its exit code, if a plain ``KeyboardInterrupt``
    has left an ``exec``, as it may while dataclasses are imported (3.11: run_eval_code_obj).
    """


class _Interrupter:
    """Raises an interrupt for a signal, once for those that come in pairs."""

    def __init__(self) -> None:
        # After the terminal was closed, nothing says any more which streams were on it
        self._terminals = [stream for stream in (sys.stdout, sys.stderr) if _is_terminal(stream)]
        self._interrupted = -math.inf

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle signal ``number``."""
        # A closed terminal fails whoever writes to it, also what saves the run
        if number == signal.SIGHUP:
            for stream in self._terminals:
                discard(stream)

        # Let a repetition pass
        now, before = time.monotonic(), self._interrupted
        if number != signal.SIGINT and now - before < REPEATED:
            return
        self._interrupted = now
        raise _Interrupt


def catch_ending_signals() -> None:
    """Let each ending signal raise ``KeyboardInterrupt`` from now on."""
    interrupter = _Interrupter()
    for number in ENDING:
        if number in KEPT_IGNORED and signal.getsignal(number) is signal.SIG_IGN:
            continue
        signal.signal(number, interrupter)


def _is_terminal(stream: IO[str]) -> bool:
    try:
        return stream.isatty()
    except ValueError:  # it is closed
        return False
