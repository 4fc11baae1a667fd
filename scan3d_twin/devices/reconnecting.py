"""What the drivers of all lidars share: they come back after the line was lost, without threads.

Functions that take time are generators that yield where they would block; the caller services other
devices meanwhile.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn, TypeVar

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import LidarSpec, ScanLine
from scan3d_twin.devices.links.transport import Transport

T = TypeVar("T")
Steps = Generator[None, None, T]
"""A generator that yields where it would block, and returns a T."""

MAX_UNREAD = 16
"""Number of unread lines kept, as in the twin."""
POLL = 0.005
"""Interval at which a waiting reader polls the port [s]."""
STALE = 1.0
"""Time without ``service`` after which waiting bytes are discarded [s]: the program computed, and
of what arrived meanwhile the port may have lost any part; assumption."""
BACKOFF = (0.1, 0.25)
"""First and longest wait between two attempts to reconnect [s]; it doubles each time."""

_log = logging.getLogger(__name__)


@dataclass
class LinkStats:
    """Statistics of a link.

    Attributes:
        reconnects: Connections after the first.
        problem: The current problem; empty if there is none.
    """

    reconnects: int = 0
    problem: str = ""


class ReconnectingLidar(ABC):
    """A ``Lidar`` behind a transport that may be unplugged.

    There are no threads: ``service`` does all work that needs no waiting, including to reconnect.
    Call it at least every 50 ms, or wait in ``read_line``. What a family adds is ``_scan``.

    Attributes:
        spec: See ``Lidar.spec``.
        stats: Statistics of the link.
    """

    spec: LidarSpec
    stats: LinkStats

    def __init__(self, open_transport: Callable[[], Transport], clock: Clock) -> None:
        """Prepare to connect.

        Args:
            open_transport: Opens the port; called again after the lidar was unplugged.
            clock: The robot's clock; its ``sleep`` may service this lidar.
        """
        self._open_transport, self._clock = open_transport, clock
        self._transport: Transport | None = None
        self._unread: deque[ScanLine] = deque(maxlen=MAX_UNREAD)
        self._connected = False
        self._last_good = -math.inf
        self._serviced = clock.now()
        self._work = self._run_work()

    def service(self, now: float | None = None) -> None:
        """Take in what has arrived, without waiting; nothing after ``close``.

        Args:
            now: Ignored; the lidar has a clock of its own.
        """
        next(self._work, None)

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        deadline = self._clock.now() + timeout
        self.service()
        while not self._unread:
            left = deadline - self._clock.now()
            if left <= 1e-9:
                problem = self._explain_missing_line()
                raise LinkTimeoutError(
                    f"no scan line within {timeout:g} s" + (f": {problem}" if problem else "")
                )
            self._clock.sleep(min(POLL, left))
            self.service()
        return self._unread.popleft()

    def close(self) -> None:
        """Leave the lidar at rest, and close the port for good."""
        self._work.close()
        transport, self._transport = self._transport, None
        if transport is not None:
            with suppress(LinkError):
                self._leave_at_rest(transport)
            transport.close()

    @abstractmethod
    def _scan(self) -> Steps[NoReturn]:
        """Open the port as ``_transport``, connect, and take in lines until the link is lost.

        Sets ``_connected`` when the lidar works, and ``_last_good`` with each line.

        Raises:
            LinkError: The link is lost, or cannot be opened.
        """

    @abstractmethod
    def _leave_at_rest(self, transport: Transport) -> None:
        """Send what ends the scan and stops the motor.

        Raises:
            LinkError: The lidar is unplugged.
        """

    def _explain_missing_line(self) -> str:
        """Return why no line arrives, as far as it is known."""
        return self.stats.problem

    def _may_reconnect(self, error: LinkError) -> bool:
        """Return whether to try again after an ``error``, not to give up."""
        return self._connected

    def _measure_absence(self) -> float:
        """Return for how long the program has not listened until now [s]; 0 unless ``STALE``."""
        now = self._clock.now()
        away, self._serviced = now - self._serviced, now
        return away if away > STALE else 0.0

    def _run_work(self) -> Steps[NoReturn]:
        """Connect, scan, and reconnect whenever the link is lost."""
        wait, longest = BACKOFF
        while True:
            # Scan until the link is lost
            started = self._clock.now()
            try:
                yield from self._scan()
            except LinkError as error:
                if not self._may_reconnect(error):
                    raise
                self._drop_link(error)

            # Wait before the next attempt
            wait = BACKOFF[0] if self._last_good > started else min(longest, 2 * wait)
            until = self._clock.now() + wait
            while self._clock.now() < until:
                yield

    def _drop_link(self, error: LinkError) -> None:
        if not self.stats.problem:
            _log.warning("lidar lost: %s; reconnecting", error)
        self.stats.problem = str(error)
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()


def wait(clock: Clock, seconds: float) -> Steps[None]:
    """Let ``seconds`` pass."""
    until = clock.now() + seconds
    while clock.now() < until:
        yield
