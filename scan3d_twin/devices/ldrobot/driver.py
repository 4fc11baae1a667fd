"""The driver of LD06, LD19 and STL27L: a ``Lidar`` over a line that only talks.

The lidar takes no commands: it turns and sends as long as it has power, and closing the line does
not stop it. Its driver listens, in whatever state the stream is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NoReturn

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.ldrobot.codec import FOREIGN, READINGS, Packet, Splitter
from scan3d_twin.devices.ldrobot.model import BOOT, SPIN_UP, TURN_RATE, LdModel
from scan3d_twin.devices.ldrobot.packet_stream import PacketStream, is_under_own_control
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.reconnecting import POLL, LinkStats, ReconnectingLidar, Steps
from scan3d_twin.devices.rotating import Revolutions

CONNECT_TIMEOUT = BOOT + SPIN_UP + 1.5
"""Time-out from opening the port to the first line, the power just switched on [s]."""
MAX_SILENCE = 1.0
"""Time of listening without a good packet after which the port is opened again [s]."""
LISTEN = 0.5
"""Time at first in which arrivals relate the lidar's timer to the clock [s]: a hundred polls, whose
earliest is less than a tenth of a millisecond late."""
MIN_PACKETS = 20
"""Packets from which the model is known by their rate."""
MAX_RATE_ERROR = 0.2
"""Share by which the rate of the readings may be off; that of the models differs by 4.8."""


class LdLidar(ReconnectingLidar):
    """A ``Lidar``: an LD06, LD19 or STL27L behind a transport.

    Attributes:
        model: Its data sheet.
    """

    def __init__(
        self, open_transport: Callable[[], Transport], clock: Clock, model: LdModel
    ) -> None:
        """Open the line and wait until the lidar turns at its speed.

        Raises:
            LinkError: Nothing arrives, or what arrives is not from such a lidar; the message says
                what to do.
        """
        super().__init__(open_transport, clock)
        self.spec, self.model, self.stats = model.spec, model, LinkStats()
        self._splitter, self._stream = Splitter(), PacketStream(model)
        self._revolutions = Revolutions(self.spec, model.readings)
        self._recent: deque[Packet] = deque(maxlen=MIN_PACKETS)
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
        if passed == 0:
            return f"no byte arrives from the {name}: check its 5 V supply and its TX wire"
        if self.speed:
            return (
                f"the {name} turns {self.speed:.1f} times a second, not {TURN_RATE:.0f}: ground "
                "its PWM wire, so that it controls its speed itself"
            )
        if self._splitter.is_foreign:
            return f"bytes arrive, but {FOREIGN}"
        return (
            f"{passed} bytes arrive, but no packet of a {name} at {self.model.baud} baud: is it "
            "another model? name it with --lidar"
        )

    def _scan(self) -> Steps[NoReturn]:
        """See ``ReconnectingLidar``."""
        # Open the port
        self._transport = transport = self._open_transport()
        transport.set_baud(self.model.baud)
        self.stats.reconnects += self._connected
        self._restart()

        # Listen
        listening = self._clock.now()
        self._measure_absence()
        while True:
            # Discard what arrived while the program computed
            now = self._clock.now()
            if self._measure_absence():
                transport.discard_input()
                self._restart()
                listening = now

            # Take in what has arrived
            if data := transport.read(0.0):
                self._take(data, now)
            if self._connected and now - max(listening, self._last_good) > MAX_SILENCE:
                raise LinkTimeoutError("no packet arrives from the lidar")
            yield

    def _leave_at_rest(self, transport: Transport) -> None:
        """Send nothing: it turns as long as it has power."""

    def _restart(self) -> None:
        """Forget what is unfinished, after bytes were lost."""
        self._splitter.restart()
        self._stream.restart()
        self._revolutions.clear()

    def _take(self, data: bytes, now: float) -> None:
        packets = self._splitter.feed(data)
        self._recent.extend(packets)
        beams = self._stream.take(packets, now)
        if len(beams):
            self._last_good, self.stats.problem = now, ""
            self._unread.extend(self._revolutions.add(beams))
