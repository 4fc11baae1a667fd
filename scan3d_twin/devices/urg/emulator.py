"""An emulated URG-04LX: serves any ``Lidar`` as bytes, with the timing of the real sensor.

Source of the timing: a capture of firmware 3.1.04 over USB; see ``model``.
"""

from __future__ import annotations

import math
from collections import deque

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.types import ScanLine
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.urg.emulated_firmware import Firmware
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.model import REPLY_LATENCY

MAX_REQUEST = 64
"""Length at which a request is cut off [bytes]; the longest valid one, MD with a tag, has 32."""
UART_BUFFER = 0.005
"""Longest time a scan waits for the previous one to leave the UART [s]; assumption: 60 bytes."""
MAX_QUEUE = 16
"""Number of requests that can wait for the tick; assumption."""
MAX_ASCII = 0x7F
"""Largest byte of a request that is kept; assumption: SCIP is text, and MRPT's search for the bit
rate, which leaves such a byte at each wrong one, is known to work with devices."""


class UrgEmulator:
    """A ``Device``: an URG-04LX that measures what ``lidar`` measures.

    Requests are answered on the firmware's tick. A scan that is ready while the UART is still busy
    with the one before is dropped as a whole.

    Attributes:
        firmware: The state of the sensor.
        dropped: Scans dropped because the line was busy.
        began: See ``Device``.
    """

    def __init__(self, lidar: Lidar, profile: UrgProfile | None = None) -> None:
        profile = UrgProfile() if profile is None else profile
        self.firmware = Firmware(profile, lidar.spec, self._latest)
        self.dropped = 0
        self.began = 0.0
        self._lidar = lidar
        self._profile = profile
        self._booted_at = 0.0
        self._clear()

    @property
    def baud(self) -> int:
        """See ``Device.baud``."""
        return self._out[0][0] if self._out else self._uart_baud()

    def power_up(self, now: float) -> None:
        """Turn the power off, and on again at ``now`` [s]."""
        self.firmware.power_up(now)
        self._booted_at = now + self._profile.boot
        self._clear()

    def receive(self, data: bytes, now: float) -> None:
        """See ``Device.receive``."""
        self._advance(now)
        if now < self._booted_at or self.firmware.mute:
            return
        for byte in data:
            if byte > MAX_ASCII:
                continue
            if byte not in b"\r\n":
                self._request += bytes([byte])[: MAX_REQUEST - len(self._request)]
            elif self._request:
                if len(self._queue) < MAX_QUEUE:
                    self._queue.append((self._tick_after(now), bytes(self._request)))
                self._request.clear()

    def transmit(self, now: float) -> bytes:
        """See ``Device.transmit``."""
        self._advance(now)
        if not self._out:
            return b""
        _, self.began, data = self._out.popleft()
        return data

    def _clear(self) -> None:
        self._request = bytearray()
        self._queue: deque[tuple[float, bytes]] = deque()
        self._turns: deque[ScanLine] = deque()
        self._last: ScanLine | None = None
        self._out: deque[tuple[int, float, bytes]] = deque()
        self._free_at = -math.inf

    def _advance(self, now: float) -> None:
        """Process everything that is due by ``now`` [s], in order of time."""
        # Collect measured turns
        if self.firmware.stream is not None:
            self._collect()

        # Send scans and answers when due
        while True:
            answer_at = self._queue[0][0] if self._queue else math.inf
            scan_at = self._turns[0].stamp + REPLY_LATENCY if self._turns else math.inf
            if min(answer_at, scan_at) > now:
                break
            if scan_at <= answer_at:
                self._send(self._turns.popleft(), scan_at)
            else:
                self._answer(answer_at)

        # Change the bit rate once idle
        if now >= self._free_at:
            self.firmware.baud = self.firmware.wanted_baud

    def _answer(self, tick: float) -> None:
        """Answer all requests that wait for this ``tick`` [s]."""
        seen: set[str] = set()
        while self._queue and self._queue[0][0] <= tick and not self.firmware.mute:
            malfunction = self.firmware.malfunction
            self._put(self.firmware.answer(self._queue.popleft()[1], tick, seen), tick)
            if self.firmware.malfunction != malfunction:
                self._put(self.firmware.interruption(self.firmware.malfunction), tick)
        if self.firmware.mute:
            self._queue.clear()

    def _send(self, line: ScanLine, now: float) -> None:
        self._last = line
        if not self.firmware.is_due(line):
            return
        if self._free_at <= now + UART_BUFFER:
            self._put(self.firmware.send(line), now)
        else:
            self.dropped += 1

    def _put(self, data: bytes, now: float) -> None:
        """Put ``data`` into the UART; a new bit rate takes effect once the UART is empty."""
        if now >= self._free_at:
            self.firmware.baud = self.firmware.wanted_baud
        if data:
            baud = self._uart_baud()
            self._out.append((baud, now, data))
            duration = len(data) * BITS_PER_BYTE / baud if baud else 0.0
            self._free_at = max(self._free_at, now) + duration

    def _uart_baud(self) -> int:
        return 0 if self._profile.usb else self.firmware.baud

    def _tick_after(self, now: float) -> float:
        tick = self._profile.tick
        return math.ceil(now / tick - 1e-9) * tick if tick else now

    def _collect(self) -> None:
        """Take in the turns measured since the last call."""
        while True:
            try:
                self._turns.append(self._lidar.read_line(0.0))
            except LinkTimeoutError:
                return

    def _latest(self, now: float) -> ScanLine | None:
        """Return the last turn whose data is ready at ``now`` [s]."""
        self._collect()
        while self._turns and self._turns[0].stamp + REPLY_LATENCY <= now:
            self._last = self._turns.popleft()
        return self._last
