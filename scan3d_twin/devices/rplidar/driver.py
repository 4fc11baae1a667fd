"""The driver of the RPLIDAR A1, C1 and S2: a ``Lidar`` over a serial line."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.line_grid import make_full_circle
from scan3d_twin.core.types import Beams, LidarSpec, ScanLine
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.reconnecting import POLL, LinkStats, ReconnectingLidar, Steps
from scan3d_twin.devices.rotating import Revolutions
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.connect import RplidarInfo, choose_mode, identify, start_scan
from scan3d_twin.devices.rplidar.link import QUIET, RplidarLink
from scan3d_twin.devices.rplidar.model import Motor, RplidarModel, ScanMode
from scan3d_twin.devices.rplidar.reading_filter import ReadingFilter
from scan3d_twin.devices.rplidar.samples import ScanStream, open_stream

CONNECT_TIMEOUT = 12.0
"""Time-out from opening the port to the first line [s]: reset and boot 2.5 s, the requests 1 s, and
twice the longest time to spin up."""
FIRST_TURN_TIMEOUT = 5.0
"""Time-out from the start of a scan to its first line [s]: spinning up takes up to 3 s."""
MAX_LINE_GAP = 1.0
"""Time of listening without a line after which the scan is started again [s]."""
MAX_RESTARTS = 3
"""Fruitless restarts after which the driver reconnects."""
FASTEST_SHARE = 1.15
"""Speed from which on the grid of the data sheet is too wide for the turns of this motor, as a
share of the nominal one: a fifth of its places would stay empty."""
SPARE_PLACES = 1.01
"""Places of a line's grid for each reading of the slowest turn."""

_log = logging.getLogger(__name__)


@dataclass
class RplidarStats(LinkStats):
    """Statistics of the link, besides those of every lidar.

    Attributes:
        good: Lines received.
        bad: Frames dropped, because they were damaged.
    """

    good: int = 0
    bad: int = 0


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


class RplidarLidar(ReconnectingLidar):
    """A ``Lidar``: an RPLIDAR behind a transport.

    Attributes:
        info: The lidar's description of itself.
    """

    stats: RplidarStats
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
        super().__init__(open_transport, clock)
        self.stats = RplidarStats()
        self._model, self._wanted = model, tuple(wanted)
        self._filter = ReadingFilter(model.noise)
        try:
            self._connect_first()
        except BaseException:
            self.close()
            raise

    @property
    def bad(self) -> int:
        """Frames dropped, because they were damaged."""
        return self.stats.bad

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

    def _leave_at_rest(self, transport: Transport) -> None:
        """Stop scan and motor."""
        transport.write(codec.encode_request(codec.Command.STOP))
        if self._model.motor is Motor.SPEED:
            until = self._clock.now() + QUIET
            while self._clock.now() < until:
                transport.read(POLL)
            transport.write(codec.encode_motor_rpm(0))
        elif self._model.motor is Motor.DTR:
            transport.set_dtr(True)

    def _scan(self) -> Steps[NoReturn]:
        """See ``ReconnectingLidar``."""
        # Open the port and find the lidar
        self._transport = self._open_transport()
        self._transport.set_baud(self._model.baud)
        link = RplidarLink(self._transport, self._clock)
        if self._model.motor is Motor.DTR:
            link.set_dtr(False)
        device, health = yield from identify(link, self._model)
        mode = yield from choose_mode(link, device, self._wanted)
        self.info = RplidarInfo(device, health, mode)
        self.stats.reconnects += self._connected

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
        before = self.stats.good
        intake = _Intake(open_stream(self._model, mode), self.stats.bad)
        self._filter.clear()
        self._measure_absence()
        listening = self._clock.now()
        while True:
            # Discard what arrived while the program computed
            now = self._clock.now()
            if self._measure_absence():
                link.forget()
                intake.restart()
                self._filter.clear()
                listening = now
            patience = MAX_LINE_GAP if self.stats.good > before else FIRST_TURN_TIMEOUT
            if now >= max(listening, self._last_good) + patience:
                break

            # Take in beams; the first turn tells the speed
            beams = intake.feed(link.take(), now)
            self.stats.bad = intake.bad
            if intake.revolutions is not None:
                for line in intake.revolutions.add(beams):
                    self._keep(line)
            elif intake.turns.rate:
                intake.revolutions = self._open_revolutions(mode, intake.turns.rate)
            yield
        silent = now - link.heard_at > MAX_LINE_GAP / 2
        self.stats.problem = "the lidar fell silent" if silent else "no good scan arrives"
        return self.stats.good > before

    def _open_revolutions(self, mode: ScanMode, turns: float) -> Revolutions:
        """Return what cuts the beams of a lidar that makes so many ``turns`` per second."""
        if not self._connected:
            self.spec = line_spec(self._model, mode)
            # The grid is that of the data sheet unless this motor's speed does not fit it
            if not self._model.slowest_turns <= turns <= FASTEST_SHARE * self._model.turns:
                self.spec = line_spec(self._model, mode, turns)
        self._connected = True
        return Revolutions(self.spec, mode.sample_rate / turns)

    def _keep(self, line: ScanLine) -> None:
        """Store a complete line."""
        self.stats.good += 1
        self.stats.problem = ""
        self._last_good = self._clock.now()
        self._unread.extend(self._filter.take(line, self.stats.bad))


class _Intake:
    """Beams of the bytes of one scan.

    Attributes:
        turns: The speed of the motor.
        revolutions: What cuts the beams into lines; None until the speed is known.
    """

    def __init__(self, stream: ScanStream, bad: int) -> None:
        """Start without bytes; ``bad`` frames were dropped in the scans before."""
        self.turns = TurnMeter()
        self.revolutions: Revolutions | None = None
        self._stream, self._bad_before = stream, bad

    @property
    def bad(self) -> int:
        """Frames dropped, in this scan and those before."""
        return self._bad_before + self._stream.bad

    def feed(self, data: bytes, now: float) -> Beams:
        """Return the beams that are certain once ``data`` has arrived at ``now`` [s]."""
        beams = self._stream.feed(data, now)
        self.turns.add(beams)
        return beams

    def restart(self) -> None:
        """Forget what is unfinished, after bytes were discarded."""
        self._stream.restart()
        if self.revolutions is None:
            self.turns = TurnMeter()
        else:
            self.revolutions.clear()


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
