"""The driver of the RPLIDAR A1, C1 and S2: a ``Lidar`` over a serial line."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.line_grid import make_full_circle
from scan3d_twin.core.types import Beams, LidarSpec, ScanLine
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.rotating import Revolutions
from scan3d_twin.devices.rplidar.connect import (
    RplidarInfo,
    choose_mode,
    identify,
    start_scan,
    stop_requests,
)
from scan3d_twin.devices.rplidar.link import RplidarLink, Steps
from scan3d_twin.devices.rplidar.model import Motor, RplidarModel, ScanMode
from scan3d_twin.devices.rplidar.reading_filter import ReadingFilter
from scan3d_twin.devices.rplidar.samples import open_stream

CONNECT_TIMEOUT = 12.0
"""Time-out from opening the port to the first line [s]: reset and boot 2.5 s, the requests 1 s, and
twice the longest time to spin up."""
FIRST_TURN_TIMEOUT = 5.0
"""Time-out from the start of a scan to its first line [s]: spinning up takes up to 3 s."""
MAX_UNREAD = 16
"""Number of unread lines kept, as in the twin."""
POLL = 0.005
"""Interval at which a waiting reader polls the port [s]."""
MAX_LINE_GAP = 1.0
"""Time without a line after which the scan is started again [s]."""
MAX_RESTARTS = 3
"""Fruitless restarts after which the driver reconnects."""
BACKOFF = (0.1, 0.25)
"""First and longest wait between two attempts to reconnect [s]; it doubles each time."""
FASTEST_SHARE = 1.15
"""Speed from which on the grid of the data sheet is too wide for the turns of this motor, as a
share of the nominal one: a fifth of its places would stay empty."""
SPARE_PLACES = 1.01
"""Places of a line's grid for each reading of the slowest turn."""

_log = logging.getLogger(__name__)


@dataclass
class RplidarStats:
    """Statistics of the link.

    Attributes:
        good: Lines received.
        bad: Frames dropped, because they were damaged.
        reconnects: Connections after the first.
        problem: The current problem; empty if there is none.
    """

    good: int = 0
    bad: int = 0
    reconnects: int = 0
    problem: str = ""


def line_spec(model: RplidarModel, mode: ScanMode, turns: float = 0.0) -> LidarSpec:
    """Return the grid of the lines of a scan ``mode``.

    Args:
        model: The lidar.
        mode: How it scans.
        turns: Turns per second of this lidar; 0 is what is usual.
    """
    turns = turns or model.turns
    slowest = turns * model.slowest_turns / model.turns
    return make_full_circle(
        math.ceil(SPARE_PLACES * mode.sample_rate / slowest),
        1.0 / turns,
        model.min_range_mm / 1000,
        model.max_range_mm / 1000,
    )


class RplidarLidar:
    """A ``Lidar``: an RPLIDAR behind a transport.

    There are no threads: ``service`` does all work that needs no waiting, including to reconnect
    after the lidar was unplugged. Call it at least every 50 ms, or wait in ``read_line``.

    Attributes:
        spec: See ``Lidar.spec``.
        info: The lidar's description of itself.
        stats: Statistics of the link.
    """

    spec: LidarSpec
    info: RplidarInfo

    def __init__(
        self,
        open_transport: Callable[[], Transport],
        clock: Clock,
        model: RplidarModel,
        wanted: Sequence[ScanMode],
    ) -> None:
        """Connect, start motor and scan.

        Args:
            open_transport: Opens the port; called again after the lidar was unplugged.
            clock: The robot's clock; its ``sleep`` may service this lidar.
            model: The kind of lidar.
            wanted: Scan modes, of which the first that the lidar has is used.

        Raises:
            LinkError: There is no such lidar, or it does not work; the message says why.
        """
        self.stats = RplidarStats()
        self._open_transport, self._clock = open_transport, clock
        self._model, self._wanted = model, tuple(wanted)
        self._unread: deque[ScanLine] = deque(maxlen=MAX_UNREAD)
        self._filter = ReadingFilter()
        self._transport: Transport | None = None
        self._connected = False
        self._last_good = -math.inf
        self._work = self._run_work()
        try:
            self._connect_first()
        except BaseException:
            self.close()
            raise

    @property
    def bad(self) -> int:
        """Frames dropped, because they were damaged."""
        return self.stats.bad

    def service(self, now: float | None = None) -> None:
        """Take in what has arrived, without waiting.

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
                why = f": {self.stats.problem}" if self.stats.problem else ""
                raise LinkTimeoutError(f"no scan line within {timeout:g} s{why}")
            self._clock.sleep(min(POLL, left))
            self.service()
        return self._unread.popleft()

    def close(self) -> None:
        """Stop scan and motor, and close the port."""
        self._work.close()
        transport, self._transport = self._transport, None
        if transport is not None:
            with suppress(LinkError):
                transport.write(stop_requests(self._model))
                if self._model.motor is Motor.DTR:
                    transport.set_dtr(True)
            transport.close()

    def _connect_first(self) -> None:
        deadline = self._clock.now() + CONNECT_TIMEOUT
        while not self._unread:
            if self._clock.now() >= deadline:
                raise LinkTimeoutError(
                    f"the lidar was not ready within {CONNECT_TIMEOUT:g} s: "
                    f"{self.stats.problem or 'it sends nothing that can be used'}"
                )
            next(self._work)
            self._clock.sleep(POLL)

    def _run_work(self) -> Steps[NoReturn]:
        """Connect, scan, and reconnect whenever the link is lost."""
        wait, longest = BACKOFF
        while True:
            # Scan until the link is lost
            started = self._clock.now()
            try:
                yield from self._scan()
            except LinkError as error:
                if not self._connected:
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

    def _scan(self) -> Steps[NoReturn]:
        """Connect and take in lines until the link is lost."""
        # Open the port and find the lidar
        self._transport = self._open_transport()
        self._transport.set_baud(self._model.baud)
        link = RplidarLink(self._transport, self._clock)
        if self._model.motor is Motor.DTR:
            link.set_dtr(False)
        device, health = yield from identify(link, self._model)
        mode = yield from choose_mode(link, device, self._wanted)
        self.info = RplidarInfo(device, health, mode)

        # Scan, and start again when nothing usable arrives
        restarts = 0
        while True:
            if (yield from self._take_lines(link, mode)):
                restarts = 0
            restarts += 1
            _log.warning("%s, starting again", self.stats.problem)
            if restarts > MAX_RESTARTS:
                raise LinkTimeoutError(f"{self.stats.problem} after {MAX_RESTARTS} starts")
            yield from link.stop_scan()

    def _take_lines(self, link: RplidarLink, mode: ScanMode) -> Steps[bool]:
        """Start the scan and take in lines until none comes; return whether any came."""
        yield from start_scan(link, self._model, mode)
        stream, turns = open_stream(self._model, mode), TurnMeter()
        revolutions: Revolutions | None = None
        self._filter.clear()
        any_line, bad = False, self.stats.bad
        silent_from = self._clock.now() + FIRST_TURN_TIMEOUT - MAX_LINE_GAP
        heard = link.received
        while self._clock.now() < max(silent_from, self._last_good) + MAX_LINE_GAP:
            # Take in beams; the first turn tells the speed
            beams = stream.feed(link.take(), self._clock.now())
            self.stats.bad = bad + stream.bad
            turns.add(beams)
            if revolutions is None and turns.rate:
                revolutions = self._open_revolutions(mode, turns.rate)
            elif revolutions is not None:
                for line in revolutions.add(beams):
                    self._keep(line)
                    any_line = True
            yield
        self.stats.problem = (
            "no good scan arrives" if link.received > heard else "the lidar fell silent"
        )
        return any_line

    def _open_revolutions(self, mode: ScanMode, turns: float) -> Revolutions:
        """Return what cuts the beams of a lidar that makes so many ``turns`` per second."""
        if not self._connected:
            self.spec = line_spec(self._model, mode)
            # The grid is that of the data sheet unless this motor's speed does not fit it
            if not self._model.slowest_turns <= turns <= FASTEST_SHARE * self._model.turns:
                self.spec = line_spec(self._model, mode, turns)
        self.stats.reconnects += self._connected
        self._connected = True
        return Revolutions(self.spec, mode.sample_rate / turns)

    def _keep(self, line: ScanLine) -> None:
        """Store a complete line."""
        self.stats.good += 1
        self.stats.problem = ""
        self._last_good = self._clock.now()
        self._unread.extend(self._filter.take(line, self.stats.bad))


class TurnMeter:
    """Measures the speed of the motor from beams.

    Attributes:
        rate: Turns per second; 0 until a whole turn has been seen.
    """

    def __init__(self) -> None:
        self.rate = 0.0
        self._turned = 0.0
        self._first: float | None = None
        self._angle = 0.0

    def add(self, beams: Beams) -> None:
        """Take in ``beams``, until a turn is complete."""
        if self.rate or not len(beams):
            return
        for time, angle in zip(beams.times.tolist(), beams.elevations.tolist(), strict=True):
            if self._first is None:
                self._first = time
            else:
                self._turned += (angle - self._angle + math.pi) % math.tau - math.pi
            self._angle = angle
            if self._turned >= math.tau and time > self._first:
                self.rate = self._turned / math.tau / (time - self._first)
                return
