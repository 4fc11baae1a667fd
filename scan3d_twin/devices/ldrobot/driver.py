"""The driver of LD06, LD19 and STL27L: a ``Lidar`` over a line that only talks.

The lidar takes no commands: it turns and sends as long as it has power, and closing the line does
not stop it. Its driver listens, in whatever state the stream is.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import LidarSpec, ScanLine
from scan3d_twin.devices.ldrobot.codec import READINGS, Packet, Splitter
from scan3d_twin.devices.ldrobot.model import BOOT, SPIN_UP, TURN_RATE, LdModel
from scan3d_twin.devices.ldrobot.packet_stream import PacketStream, is_under_own_control
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.rotating import Revolutions

CONNECT_TIMEOUT = BOOT + SPIN_UP + 1.5
"""Time-out from opening the port to the first line, the power just switched on [s]."""
MAX_UNREAD = 16
"""Number of unread lines kept, as in the twin."""
POLL = 0.005
"""Interval at which a waiting reader polls the port [s]."""
MAX_SILENCE = 1.0
"""Time without a good packet after which the port is opened again [s]."""
BACKOFF = (0.1, 0.25)
"""First and longest wait between two attempts to open the port again [s]; it doubles each time."""
LISTEN = 0.5
"""Time at first in which arrivals relate the lidar's timer to the clock [s]: a hundred polls, whose
earliest is less than a tenth of a millisecond late."""
MIN_FOREIGN_SHARE = 0.002
"""Share of the bytes that begin a packet of another protocol from which on it is that; two given
bytes are 0.000015 of random ones, its packets have at most 200 [assumption]."""
MIN_PACKETS = 20
"""Packets from which the model is known by their rate."""
MAX_RATE_ERROR = 0.2
"""Share by which the rate of the readings may be off; that of the models differs by 4.8."""

_log = logging.getLogger(__name__)


class LdLidar:
    """A ``Lidar``: an LD06, LD19 or STL27L behind a transport.

    There are no threads: ``service`` does all work. Call it at least every 50 ms, or wait in
    ``read_line``.

    Attributes:
        spec: See ``Lidar.spec``.
        model: Its data sheet.
        reconnects: Times that the port was opened again.
        problem: The current problem; empty if there is none.
    """

    spec: LidarSpec

    def __init__(
        self, open_transport: Callable[[], Transport], clock: Clock, model: LdModel
    ) -> None:
        """Open the line and wait until the lidar turns at its speed.

        Raises:
            LinkError: Nothing arrives, or what arrives is not from such a lidar; the message says
                what to do.
        """
        self.spec, self.model = model.spec, model
        self.reconnects, self.problem = 0, ""
        self._open_transport, self._clock = open_transport, clock
        self._transport: Transport | None = None
        self._splitter, self._stream = Splitter(), PacketStream(model)
        self._revolutions = Revolutions(self.spec, model.readings)
        self._unread: deque[ScanLine] = deque(maxlen=MAX_UNREAD)
        self._recent: deque[Packet] = deque(maxlen=MIN_PACKETS)
        self._connected = False
        self._last_good, self._retry_at, self._wait = clock.now(), -math.inf, BACKOFF[0]
        self._open()
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

    @property
    def bad(self) -> int:
        """Packets dropped: damaged, or implausible in spite of a good checksum."""
        return self._splitter.bad + self._stream.rejected

    @property
    def speed(self) -> float:
        """Turn rate by the last packet [Hz]."""
        return self._stream.speed

    def service(self, now: float | None = None) -> None:
        """Take in what has arrived, without waiting; open the port again if the line is lost.

        Args:
            now: Ignored; the lidar has a clock of its own.
        """
        now = self._clock.now()
        if self._transport is None:
            self._reopen(now)
            return
        try:
            data = self._transport.read(0.0)
        except LinkError as error:
            self._drop_link(str(error), now)
            return
        if data:
            self._take(data, now)
        if now - self._last_good > MAX_SILENCE and self._connected:
            self._drop_link("no packet arrives from the lidar", now)

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        deadline = self._clock.now() + timeout
        self.service()
        while not self._unread:
            left = deadline - self._clock.now()
            if left <= 1e-9:
                why = f": {self.problem}" if self.problem else ""
                raise LinkTimeoutError(f"no scan line within {timeout:g} s{why}")
            self._clock.sleep(min(POLL, left))
            self.service()
        return self._unread.popleft()

    def close(self) -> None:
        """Close the port; the lidar goes on turning until its power is switched off."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _open(self) -> None:
        self._transport = self._open_transport()
        self._transport.set_baud(self.model.baud)

    def _connect(self) -> None:
        """Wait for the first line at full speed."""
        deadline, heard = self._clock.now() + CONNECT_TIMEOUT, math.inf
        while not (self._unread and self._clock.now() - heard >= LISTEN):
            if self._clock.now() >= deadline:
                raise LinkTimeoutError(self._explain_no_line())
            self._unread.clear()
            self._clock.sleep(POLL)
            self.service()
            self._check_model()
            known = is_under_own_control(self.speed)
            heard = min(heard, self._clock.now()) if known else math.inf
        self._connected = True

    def _check_model(self) -> None:
        """Check the rate of the readings, which differs between the models.

        Raises:
            LinkError: It is that of another model.
        """
        if len(self._recent) < MIN_PACKETS:
            return
        rates = sorted(
            100 * packet.speed * (READINGS - 1) / max(1, packet.span) for packet in self._recent
        )
        rate = rates[MIN_PACKETS // 2]
        if abs(rate / self.model.sample_rate - 1) > MAX_RATE_ERROR:
            raise LinkError(
                f"the lidar measures {rate:.0f} times a second, but a {self.model.name} "
                f"{self.model.sample_rate:.0f} times: name its model with --lidar"
            )

    def _explain_no_line(self) -> str:
        """Return why there is no line, and what to do."""
        name, passed = self.model.name, self._splitter.passed
        if self.problem:
            return f"no {name} answers: {self.problem}"
        if passed == 0:
            return f"no byte arrives from the {name}: check its 5 V supply and its TX wire"
        if self.speed:
            return (
                f"the {name} turns {self.speed:.1f} times a second, not {TURN_RATE:.0f}: ground "
                "its PWM wire, so that it controls its speed itself"
            )
        if self._splitter.foreign > MIN_FOREIGN_SHARE * passed:
            return (
                "bytes arrive, but in another protocol (AA 55): a COIN-D4, which is sold as LD19 "
                "too; it is not supported"
            )
        return (
            f"{passed} bytes arrive, but no packet of a {name} at {self.model.baud} baud: is it "
            "another model? name it with --lidar"
        )

    def _take(self, data: bytes, now: float) -> None:
        packets = self._splitter.feed(data)
        self._recent.extend(packets)
        beams = self._stream.take(packets, now)
        if len(beams):
            self._last_good, self.problem = now, ""
            self._unread.extend(self._revolutions.add(beams))

    def _drop_link(self, problem: str, now: float) -> None:
        if not self.problem:
            _log.warning("lidar lost: %s; opening its port again", problem)
        self.problem = problem
        self.close()
        self._wait = BACKOFF[0]
        self._retry_at = now + self._wait

    def _reopen(self, now: float) -> None:
        if now < self._retry_at:
            return
        try:
            self._open()
        except LinkError as error:
            self.problem = str(error)
            self._wait = min(BACKOFF[1], 2 * self._wait)
            self._retry_at = now + self._wait
            return
        self.reconnects += 1
        self._last_good = now
        self._splitter = _continue(self._splitter)
        self._stream.restart()
        self._revolutions.clear()


def _continue(splitter: Splitter) -> Splitter:
    """Return a splitter without the beginning of a packet, which counts on."""
    fresh = Splitter()
    fresh.bad, fresh.passed, fresh.foreign = splitter.bad, splitter.passed, splitter.foreign
    return fresh
