"""Clock synchronisation: from the lidar's timer to the host's clock, by wrap, offset and skew."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.codec import TIMER_BITS
from scan3d_twin.devices.urg.model import REPLY_LATENCY

WINDOW = 60.0
"""Age up to which scans are used to estimate the clock skew [s]."""
MIN_BASELINE = 2.0
"""Shortest series from which the skew is estimated [s]; arrivals scatter by the 5 ms of a poll."""
MAX_SKEW = 0.01
"""Largest clock skew accepted; 0.004 in a capture of firmware 3.1.04, a quartz is far better."""
LEARNING_TIME = 20.0
"""Time after the time mode during which the latency is estimated from its offset [s]."""
LATENCIES = (0.03, 0.25)
"""Smallest and largest plausible latency [s]; a scan itself takes 71 ms, the capture has 101 ms."""
MAX_EARLY, MAX_LATE, MAX_LATE_STALLED = 0.03, 0.5, 2.0
"""Tolerance of a scan's arrival [s]: how early it may be, how late at the usual rate, and how late
after a stall."""
MAX_COUNTED_TURNS = 3.5
"""Turns of the mirror that are counted to time a scan [turns]: at 0.3 % off the nominal speed, as
in the capture, three are 1 ms off, the resolution of the timer."""
MAX_TURN_JITTER = 0.3
"""Deviation of an arrival from a whole number of turns up to which it is clear [turns]; the poll
takes 0.05 turns."""
MAX_IMPLAUSIBLE = 3
"""Implausible stamps in a row after which the sensor's timer must have been reset."""


class SensorClock:
    """Maps the sensor's timer to the host's clock.

    Messages arrive with a random delay, but never early. Offset and skew are therefore those of the
    highest line below all points (sensor time, arrival - sensor time): the edge of their lower
    convex hull below their mean (Moon, Skelly, Towsley, "Estimation and removal of clock skew from
    network delay measurements", INFOCOM 1999).

    Attributes:
        latency: Time from step 0 of a scan to the start of its reply [s].
    """

    def __init__(self, latency: float = REPLY_LATENCY) -> None:
        self.latency = latency
        self._last_ms: int | None = None
        self._seconds = 0.0
        self._points: deque[tuple[float, float]] = deque()
        self._anchor: tuple[float, float] | None = None
        self._implausible = 0

    def anchor(self, time_ms: int, arrival: float) -> None:
        """Take in the timer read in time mode.

        Args:
            time_ms: Timer in the reply, 24 bits.
            arrival: Time at which the reply began to arrive [s].
        """
        seconds = self._unwrap(time_ms)
        offset = arrival - seconds
        if self._anchor is None or offset < self._anchor[1]:
            self._anchor = seconds, offset
        self._accept(time_ms, seconds)

    def stamp(self, time_ms: int, arrival: float) -> float:
        """Return the time on the host's clock at which the sensor's timer was ``time_ms`` [s].

        Args:
            time_ms: Timer of a scan, 24 bits.
            arrival: Time at which its reply began to arrive [s].

        Raises:
            ProtocolError: The stamp is inconsistent with those of the previous scans.
        """
        # Update the points of the window
        seconds = self._check(time_ms, arrival)
        self._points.append((seconds, arrival - seconds))
        while self._points[0][0] < seconds - WINDOW:
            self._points.popleft()
        return self._to_host(seconds)

    def stamp_late(self, time_ms: int, arrival: float) -> float:
        """Return the same for a scan of which only the end of its arrival is known [s].

        Raises:
            ProtocolError: As for ``stamp``, or there is no scan before it.
        """
        if not self._points:
            raise ProtocolError("the start of its arrival is not known, nor is a scan before it")
        seconds = self._check(time_ms, arrival)
        if not self._points:
            raise ProtocolError("the sensor's timer was reset")
        return self._to_host(seconds)

    def stamp_by_turns(self, arrival: float, period: float) -> float:
        """Return the time of a scan whose timer was garbled, by counting turns since the last one.

        Args:
            arrival: Time at which its reply began to arrive [s].
            period: Time between two scans [s].

        Raises:
            ProtocolError: The number of turns is not clear.
        """
        if not self._points:
            raise ProtocolError("the scan has no time, nor has any before it")
        seconds, late = self._points[-1]
        turns = (arrival - seconds - late) / period
        if not 0.5 < turns < MAX_COUNTED_TURNS or abs(turns - round(turns)) > MAX_TURN_JITTER:
            raise ProtocolError(f"the scan has no time, {turns:.1f} turns after the one before")
        return self._to_host(seconds + round(turns) * period)

    def _check(self, time_ms: int, arrival: float) -> float:
        """Return the unwrapped timer of a scan [s].

        Raises:
            ProtocolError: It is inconsistent with those before.
        """
        seconds = self._unwrap(time_ms)
        known = self._anchor is not None or len(self._points) > 0
        if known and not self._is_plausible(seconds, arrival):
            self._implausible += 1
            if self._implausible < MAX_IMPLAUSIBLE:
                raise ProtocolError(f"its time, {time_ms} ms, does not fit the scans before")
            self._restart()
            seconds = self._unwrap(time_ms)
        self._accept(time_ms, seconds)
        return seconds

    def _to_host(self, seconds: float) -> float:
        """Return the time on the host's clock of a scan at ``seconds`` of the unwrapped timer."""
        offset, skew = self._fit()
        offset = self._learn_latency(seconds, offset, skew)
        return seconds + offset + skew * seconds - self.latency

    def _restart(self) -> None:
        """Forget everything except the latency."""
        self._last_ms = self._anchor = None
        self._points.clear()

    def _unwrap(self, time_ms: int) -> float:
        """Return the unwrapped timer relative to its first value [s]; earlier ones are negative."""
        if self._last_ms is None:
            return 0.0
        half = 1 << TIMER_BITS - 1
        return self._seconds + ((time_ms - self._last_ms + half) % (2 * half) - half) / 1000

    def _accept(self, time_ms: int, seconds: float) -> None:
        self._last_ms, self._seconds, self._implausible = time_ms, seconds, 0

    def _is_plausible(self, seconds: float, arrival: float) -> bool:
        """Return whether a scan taken at ``seconds`` may arrive at ``arrival`` [s]."""
        # Delay relative to the expected arrival
        if self._anchor is not None and seconds < self._anchor[0] + LEARNING_TIME:
            since, offset = self._anchor
            delay = arrival - seconds - offset - LATENCIES[0]
        else:
            since = self._seconds
            offset, skew = self._fit()
            delay = arrival - seconds - offset - skew * seconds

        # Allow for the unknown skew: at first, or after a long silence
        slack = MAX_EARLY + MAX_SKEW * abs(seconds - since)
        if not self._points:
            return -slack < delay < MAX_LATE_STALLED

        # After a stall scans arrive in a burst; a late scan at the usual rate means a reset timer
        before, late = self._points[-1]
        passed = seconds - before
        steady = abs(arrival - late - before - passed) < 0.5 * passed
        return passed > 0 and -slack < delay < (MAX_LATE if steady else MAX_LATE_STALLED)

    def _fit(self) -> tuple[float, float]:
        """Return (offset [s], skew) of the line below the points."""
        # A short series gives the offset only
        points = self._points
        if points[-1][0] - points[0][0] < MIN_BASELINE:
            return min(y for _, y in points), 0.0

        # Lower convex hull
        middle = sum(x for x, _ in points) / len(points)
        hull: list[tuple[float, float]] = []
        for point in points:
            while len(hull) > 1 and _turns_right(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)

        # Slope of the edge below the mean
        (x0, y0), (x1, y1) = next(edge for edge in pairwise(hull) if edge[1][0] >= middle)
        skew = (y1 - y0) / (x1 - x0)
        if abs(skew) > MAX_SKEW:
            skew = math.copysign(MAX_SKEW, skew)
        return min(y - skew * x for x, y in points), skew

    def _learn_latency(self, seconds: float, offset: float, skew: float) -> float:
        """Estimate the latency from the time mode's offset; return the corrected ``offset``."""
        if self._anchor is None or seconds > self._anchor[0] + LEARNING_TIME:
            return offset
        latency = offset + skew * self._anchor[0] - self._anchor[1]
        # Beyond the largest plausible latency, every scan to this point must have been held up.
        excess = max(0.0, latency - LATENCIES[1])
        if latency >= LATENCIES[0]:
            self.latency = latency - excess
        return offset - excess


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Return whether b lies on or above the line from a to c."""
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
