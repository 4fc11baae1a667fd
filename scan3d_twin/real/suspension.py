"""Noticing that this process was suspended, by Ctrl-Z or SIGSTOP, and continued."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def count_continuations() -> Iterator[Callable[[], int]]:
    """Yield a function that returns how often this process was continued (SIGCONT) since.

    Signals can be caught in the main thread only; in another one the count stays 0.
    """
    count = 0

    def on_continue(number: int, frame: FrameType | None) -> None:
        nonlocal count
        count += 1

    if threading.current_thread() is not threading.main_thread():
        yield lambda: 0
        return
    before = signal.signal(signal.SIGCONT, on_continue)
    try:
        yield lambda: count
    finally:
        signal.signal(signal.SIGCONT, before)
