"""From the servo's timer, which counts milliseconds and wraps, to the time on the host's clock."""

from __future__ import annotations

from collections import deque

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.dynamixel.model import TICK, TICK_PERIOD

WINDOW = 10.0
"""Age up to which readings set the offset [s]: a skew of 0.01 % moves it by a tick meanwhile."""
MAX_SKEW = 0.01
"""Largest clock skew [s/s]; assumption: the servo's oscillator may have no quartz."""
TOLERANCE = 0.004
"""Time by which a reading may lie outside of question and answer [s]; assumption."""
MAX_IMPLAUSIBLE = 3
"""Implausible ticks in a row after which the servo must have started anew."""


class RestartedError(ProtocolError):
    """The servo's timer has started anew: it lost its power."""


class TickClock:
    """Maps the timer to the host's clock.

    A reading is taken when the question has arrived: never before it is sent. The timer rounds down
    to a tick. So the largest (time sent - timer) of the last seconds is the offset to within a
    tick, whatever delays single questions, and each reading lies within the tick that ends there.
    """

    def __init__(self) -> None:
        self._last: tuple[float, int] | None = None
        self._seconds = 0.0
        self._offsets: deque[tuple[float, float]] = deque()
        self._implausible = 0

    def stamp(self, tick: int, sent: float, received: float) -> float:
        """Return the time at which the timer was ``tick`` [s].

        Args:
            tick: Timer in the answer.
            sent: Time at which the last byte of the question left, at the earliest [s].
            received: Time at which the answer was there, at the latest [s].

        Raises:
            RestartedError: The timer was set back.
            ProtocolError: The tick does not fit those before.
        """
        # Unwrap by the time that has passed
        seconds = self._unwrap(tick, sent)
        while len(self._offsets) > 1 and self._offsets[0][0] < sent - WINDOW:
            self._offsets.popleft()
        offset = self._offsets[0][1] if self._offsets else None
        slack = TOLERANCE + MAX_SKEW * (0.0 if self._last is None else sent - self._last[0])
        if offset is not None and not sent - slack < seconds + offset < received + slack:
            self._implausible += 1
            if self._implausible >= MAX_IMPLAUSIBLE:
                raise RestartedError("the servo has started anew: did its supply break down?")
            raise ProtocolError(f"its timer, {tick} ms, does not fit the readings before")

        # Keep it for the offset: those that are the largest since their time
        self._implausible = 0
        self._last, self._seconds = (sent, tick), seconds
        while self._offsets and self._offsets[-1][1] <= sent - seconds:
            self._offsets.pop()
        self._offsets.append((sent, sent - seconds))
        latest = seconds + self._offsets[0][1]
        return min(received, max(sent, latest - TICK))

    def _unwrap(self, tick: int, sent: float) -> float:
        """Return the timer, counted on from its first value [s]."""
        if self._last is None:
            return 0.0
        before, last = self._last
        period = TICK * TICK_PERIOD
        step = TICK * (tick - last)
        return self._seconds + step + period * round((sent - before - step) / period)
