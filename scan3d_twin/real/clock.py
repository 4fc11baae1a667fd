"""The real clock: the only code in ``real`` that reads the system clock."""

from __future__ import annotations

import time


class RealClock:
    """A monotonic ``Clock`` that starts at 0 when it is created."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """See ``Clock.now``."""
        return time.monotonic() - self._start

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``; services no drivers."""
        time.sleep(max(0.0, seconds))
