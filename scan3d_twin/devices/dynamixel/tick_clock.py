"""From the servo's timer, which counts milliseconds and wraps, to the time on the host's clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.dynamixel.model import TICK, TICK_PERIOD

WINDOW = 10.0
"""Age up to which readings set the offset [s]: a skew of 0.01 % moves it by a tick meanwhile."""
MAX_SKEW = 0.01
"""Largest clock skew [s/s]; assumption: the servo's oscillator may have no quartz."""
MAX_EARLY, MAX_LATE = 0.6, 0.004
"""Time by which a reading may lie before its question and after its answer [s]; assumption. An
emulated servo on a busy computer answers from up to half a second ago."""
MAX_IMPLAUSIBLE = 3
"""Implausible ticks in a row after which the servo must have started anew."""


class RestartedError(ProtocolError):
    """The servo has started anew: it lost its power."""

    def __init__(self) -> None:
        super().__init__("the servo has started anew: did its supply break down?")


class _Extreme:
    """The largest, or smallest, value of the last ``WINDOW`` seconds."""

    def __init__(self, choose: Callable[[float, float], float]) -> None:
        """Keep that of two values which ``choose`` returns."""
        self._choose = choose
        self._values: deque[tuple[float, float]] = deque()

    def add(self, stamp: float, value: float) -> float:
        """Add a ``value`` at ``stamp`` [s]; return the extreme."""
        values = self._values
        while values and self._choose(values[-1][1], value) == value:
            values.pop()
        values.append((stamp, value))
        while values[0][0] < stamp - WINDOW:
            values.popleft()
        return values[0][1]


class TickClock:
    """Maps the timer to the host's clock.

    A reading is taken when the question has arrived: after it is sent and before the answer is
    there. The timer rounds down to a tick. So the largest (time sent - timer) of the last seconds
    is the offset to within a tick, whatever delays single questions, and the reading lies in the
    tick that ends there.

    Where some (time received - timer) is less than that, the servo answered from the past, as an
    emulated one does on a busy computer: then that is the offset, as the drivers of lidars have it.
    """

    def __init__(self) -> None:
        self._last: tuple[float, int] | None = None
        self._seconds = self._offset = 0.0
        self._from_sent, self._from_received = _Extreme(max), _Extreme(min)
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
        if self._last is not None:
            expected = seconds + self._offset
            slack = MAX_SKEW * (sent - self._last[0])
            if not sent - MAX_EARLY - slack < expected < received + MAX_LATE + slack:
                self._implausible += 1
                if self._implausible >= MAX_IMPLAUSIBLE:
                    raise RestartedError
                raise ProtocolError(f"its timer, {tick} ms, does not fit the readings before")

        # Keep it for the offset
        self._implausible = 0
        self._last, self._seconds = (sent, tick), seconds
        earliest = self._from_sent.add(sent, sent - seconds)
        self._offset = min(earliest, self._from_received.add(sent, received - seconds))
        latest = seconds + self._offset
        return min(latest, max(sent, latest - TICK))

    def _unwrap(self, tick: int, sent: float) -> float:
        """Return the timer, counted on from its first value [s]."""
        if self._last is None:
            return 0.0
        before, last = self._last
        period = TICK * TICK_PERIOD
        step = TICK * (tick - last)
        return self._seconds + step + period * round((sent - before - step) / period)
