"""From the lidar's timer to the host's clock: wrap, offset and skew."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.codec import TIMER_BITS
from scan3d_twin.devices.urg.model import REPLY_LATENCY

WINDOW = 60.0
"""Scans of the last minute tell the skew [s]."""
MIN_BASELINE = 2.0
"""Shorter series say nothing about the skew [s]; arrivals scatter by the 5 ms of a poll."""
MAX_SKEW = 0.01
"""A quartz is far better; .4 % in a capture of firmware 3.1.04."""
LEARNING = 20.0
"""For so long after the time mode its offset and the scans' arrival tell the latency [s]."""
LATENCIES = (0.03, 0.25)
"""Latency that can be believed [s]; the scan itself takes 71 ms, the capture has 101 ms."""
EARLY, STEADY, LATE = 0.03, 0.5, 2.0
"""How far a scan may be ahead of what is expected, and behind it: at the usual pace, and after a
stall [s]."""
PATIENCE = 3
"""After so many stamps in a row that cannot be, the sensor's timer must have been reset."""


class SensorClock:
    """Maps the sensor's timer to the host's clock.

    Every message arrives a little late, by chance, and never early. So the line under all points
    (sensor time, arrival - sensor time) that is nearest to them gives offset and skew: the edge of
    their lower convex hull below their mean (Moon, Skelly, Towsley, "Estimation and removal of
    clock skew from network delay measurements", INFOCOM 1999).

    Attributes:
        latency: From step 0 of a scan to the start of its reply [s].
    """

    def __init__(self, latency: float = REPLY_LATENCY) -> None:
        self.latency = latency
        self._last_ms: int | None = None
        self._seconds = 0.0
        self._points: deque[tuple[float, float]] = deque()
        self._anchor: tuple[float, float] | None = None
        self._refused = 0

    def anchor(self, time_ms: int, arrival: float) -> None:
        """Take in the timer as the time mode told it in a reply that arrived at ``arrival``."""
        seconds = self._unwrapped(time_ms)
        offset = arrival - seconds
        if self._anchor is None or offset < self._anchor[1]:
            self._anchor = seconds, offset
        self._accept(time_ms, seconds)

    def stamp(self, time_ms: int, arrival: float) -> float:
        """Return when on the host's clock the sensor's timer was ``time_ms`` [s].

        Args:
            time_ms: The time of a scan, 24 bits.
            arrival: When its reply began to arrive [s].

        Raises:
            ProtocolError: That cannot be, seen from the scans before.
        """
        seconds = self._unwrapped(time_ms)
        known = self._anchor is not None or len(self._points) > 0
        if known and not self._plausible(seconds, arrival):
            self._refused += 1
            if self._refused < PATIENCE:
                raise ProtocolError(f"time {time_ms} ms does not fit the scans before")
            self._restart()
            seconds = self._unwrapped(time_ms)
        self._accept(time_ms, seconds)
        self._points.append((seconds, arrival - seconds))
        while self._points[0][0] < seconds - WINDOW:
            self._points.popleft()
        offset, skew = self._fit()
        offset = self._checked(seconds, offset, skew)
        return seconds + offset + skew * seconds - self.latency

    def _restart(self) -> None:
        """Forget all but the latency."""
        self._last_ms = self._anchor = None
        self._points.clear()

    def _unwrapped(self, time_ms: int) -> float:
        """Return the time since the first one seen [s], earlier ones negative."""
        if self._last_ms is None:
            return 0.0
        half = 1 << TIMER_BITS - 1
        return self._seconds + ((time_ms - self._last_ms + half) % (2 * half) - half) / 1000

    def _accept(self, time_ms: int, seconds: float) -> None:
        self._last_ms, self._seconds, self._refused = time_ms, seconds, 0

    def _plausible(self, seconds: float, arrival: float) -> bool:
        """Return whether a scan may come so early, or so late."""
        if self._anchor is not None and seconds < self._anchor[0] + LEARNING:
            since, offset = self._anchor
            delay = arrival - seconds - offset - LATENCIES[0]
        else:
            since = self._seconds
            offset, skew = self._fit()
            delay = arrival - seconds - offset - skew * seconds
        # The skew is not known at first, or after a long silence.
        slack = EARLY + MAX_SKEW * abs(seconds - since)
        if not self._points:
            return -slack < delay < LATE
        before, late = self._points[-1]
        passed = seconds - before
        # After a stall all come at once; who is late at the usual pace has another timer.
        steady = abs(arrival - late - before - passed) < 0.5 * passed
        return passed > 0 and -slack < delay < (STEADY if steady else LATE)

    def _fit(self) -> tuple[float, float]:
        """Return (offset [s], skew) of the line under the points."""
        points = self._points
        if points[-1][0] - points[0][0] < MIN_BASELINE:
            return min(y for _, y in points), 0.0
        middle = sum(x for x, _ in points) / len(points)
        hull: list[tuple[float, float]] = []
        for point in points:
            while len(hull) > 1 and _turns_right(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        (x0, y0), (x1, y1) = next(edge for edge in pairwise(hull) if edge[1][0] >= middle)
        skew = (y1 - y0) / (x1 - x0)
        if abs(skew) > MAX_SKEW:
            skew = math.copysign(MAX_SKEW, skew)
        return min(y - skew * x for x, y in points), skew

    def _checked(self, seconds: float, offset: float, skew: float) -> float:
        """Learn the latency from what the time mode said, and return the offset it allows."""
        if self._anchor is None or seconds > self._anchor[0] + LEARNING:
            return offset
        latency = offset + skew * self._anchor[0] - self._anchor[1]
        # Scans that came later than that were held up, all of them so far.
        excess = max(0.0, latency - LATENCIES[1])
        if latency >= LATENCIES[0]:
            self.latency = latency - excess
        return offset - excess


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Return whether b lies on or above the line from a to c."""
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
