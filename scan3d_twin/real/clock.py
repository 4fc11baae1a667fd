"""The real clock: the only place in ``real`` that asks the operating system for the time."""

from __future__ import annotations

import time


class RealClock:
    """A ``Clock`` that starts at 0 when it is made; it never jumps with the date."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """See ``Clock.now``."""
        return time.monotonic() - self._start

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``; services nothing by itself."""
        time.sleep(max(0.0, seconds))
