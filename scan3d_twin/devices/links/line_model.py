"""Model of the serial line between an emulated device and its client: speed, buffer, faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.uart import Uart

BUFFER = 65536
"""Size of the client's input buffer [bytes]; what does not fit is lost. Assumption: Linux keeps up
to 640 KiB behind its 4 KiB, adapters much less."""
POLL = 0.002
"""Interval at which a reader in virtual time polls the line [s]."""


class Device(Protocol):
    """An emulated device: bytes in, bytes out, on the simulated clock only.

    It may have an attribute ``began``: the time [s] at which the bytes returned by the last
    ``transmit`` were put on the line. Without it that is the time of the call to ``transmit``, so
    that a late call delays the bytes. It may have a method ``set_dtr(on, now)``: the client's modem
    line DTR, over a ``Wire``.
    """

    @property
    def baud(self) -> int:
        """Bit rate of the next bytes from ``transmit``, or of its UART; 0 for USB [bit/s]."""
        ...

    def receive(self, data: bytes, now: float) -> None:
        """Take in ``data``, which arrived by ``now`` [s]."""
        ...

    def transmit(self, now: float) -> bytes:
        """Return bytes put on the line by ``now`` [s] at one bit rate; b"" if there are no more."""
        ...


@dataclass(frozen=True, slots=True)
class Faults:
    """Random transmission errors of a line, in both directions; drawn from the line's seed.

    Attributes:
        drop: Probability that a byte is lost, 0..1.
        insert: Probability that a byte is followed by one that was never sent, 0..1.
        flip: Probability that one bit of a byte is flipped, 0..1.
        stalls: Stalls per second; during a stall nothing arrives, afterwards everything at once.
        stall: Length of a stall [s].
        junk: Bytes in the port when it is opened.
        silent: Whether a wrong bit rate yields nothing instead of what a UART reads of it.
    """

    drop: float = 0.0
    insert: float = 0.0
    flip: float = 0.0
    stalls: float = 0.0
    stall: float = 0.3
    junk: bytes = b""
    silent: bool = False


NO_FAULTS = Faults()


@dataclass(slots=True)
class _Burst:
    """Bytes in transmission at one bit rate; the first one starts at ``start`` [s]."""

    start: float
    baud: int
    data: bytes

    def arrived(self, now: float) -> int:
        """Return the number of bytes transmitted by ``now`` [s]."""
        if self.baud == 0:
            return len(self.data) if now >= self.start else 0
        # Allow a nanosecond for the rounding of the clock.
        whole = int((now - self.start + 1e-9) * self.baud / BITS_PER_BYTE)
        return max(0, min(len(self.data), whole))

    @property
    def end(self) -> float:
        """Time at which the last byte is transmitted [s]."""
        return self.start + (len(self.data) * BITS_PER_BYTE / self.baud if self.baud else 0.0)


class Line:
    """A line to ``device``, on the simulated clock.

    Attributes:
        device: The emulated device.
        faults: Transmission errors; may be changed at any time.
        latency: Time from the arrival of a byte at the client's adapter until its program may read
            it [s].
        plugged: Whether the line is plugged in.
        passed: Number of bytes that have reached the client, after faults.
    """

    def __init__(
        self, device: Device, faults: Faults = NO_FAULTS, seed: int = 0, latency: float = 0.0
    ) -> None:
        self.device = device
        self.faults = faults
        self.latency = latency
        self.plugged = True
        self.passed = 0
        self._rng = np.random.default_rng(seed)
        self._device_uart, self._client_uart = Uart(2 * seed), Uart(2 * seed + 1)
        self._up: deque[_Burst] = deque()
        self._down: deque[_Burst] = deque()
        self._free_at = 0.0
        self._arrived = bytearray()
        self._stalled_until = 0.0
        self._looked = 0.0

    def open(self, now: float) -> None:
        """Open the client's end; what the device sent before is lost.

        Raises:
            LinkError: The line is unplugged.
        """
        if not self.plugged:
            raise LinkError("there is no such port: the line is unplugged")
        while self.device.transmit(now):
            pass
        self._down.clear()
        self._arrived = bytearray(self.faults.junk)

    def discard(self, now: float, baud: int) -> None:
        """Discard what has arrived at the client."""
        self.receive(now, baud)

    def send(self, data: bytes, now: float, baud: int) -> None:
        """Send ``data`` from the client at ``baud`` [bit/s]; 0 matches any bit rate."""
        self._pull(now, baud)
        if self.plugged and data:
            speed = self.device.baud
            start = max([now, *(burst.end for burst in self._up)])
            heard = self._decode_at(self._device_uart, data, start, baud, speed)
            self._up.append(_Burst(start, speed if baud else 0, self._add_faults(heard)))
            self._push(now)

    def receive(self, now: float, baud: int) -> bytes:
        """Return what has arrived by ``now`` [s] at a client that receives at ``baud`` [bit/s]."""
        self._pull(now, baud)
        data = bytes(self._arrived)
        self._arrived.clear()
        return data

    def _push(self, now: float) -> None:
        """Deliver to the device what has reached it, each burst at its time of arrival."""
        while self._up and self._up[0].end <= now + 1e-9:
            burst = self._up.popleft()
            self.device.receive(burst.data, max(burst.end, self._looked))
        if not self._up and (rest := self._device_uart.idle(now)):
            self.device.receive(self._add_faults(rest), now)

    def _pull(self, now: float, baud: int) -> None:
        """Transfer the bytes of both directions up to ``now`` [s]."""
        # Client to device
        self._push(now)

        # Device to line
        speed = self.device.baud
        while data := self.device.transmit(now):
            self._free_at = max(getattr(self.device, "began", now), self._free_at)
            self._down.append(_Burst(self._free_at, speed, data))
            self._free_at = self._down[-1].end
            speed = self.device.baud

        # Line to client
        if not self.plugged:
            self._down.clear()
        if not self._is_stalled(now):
            for data, start, speed in self._take_arrived(now - self.latency):
                heard = self._decode_at(self._client_uart, data, start, speed, baud)
                self._store(self._add_faults(heard))
            self._store(self._add_faults(self._client_uart.idle(now - self.latency)))
        self._looked = now

    def _take_arrived(self, now: float) -> Iterator[tuple[bytes, float, int]]:
        """Yield (bytes, start, bit rate) that have arrived by ``now`` [s], and remove them."""
        while self._down and (count := self._down[0].arrived(now)):
            burst = self._down.popleft()
            yield burst.data[:count], burst.start, burst.baud
            if count < len(burst.data):
                rest = burst.data[count:]
                start = burst.start + count * BITS_PER_BYTE / burst.baud
                self._down.appendleft(_Burst(start, burst.baud, rest))
                return

    def _store(self, data: bytes) -> None:
        self.passed += len(data)
        self._arrived += data[: BUFFER - len(self._arrived)]

    def _is_stalled(self, now: float) -> bool:
        expected = self.faults.stalls * (now - self._looked)
        if now >= self._stalled_until and expected > 0 and self._rng.random() < expected:
            self._stalled_until = now + self.faults.stall
        return now < self._stalled_until

    def _decode_at(self, uart: Uart, data: bytes, start: float, sent: int, heard: int) -> bytes:
        """Return what ``uart`` at ``heard`` baud receives of ``data`` sent at ``sent`` baud."""
        if sent == heard or not sent or not heard:
            return data
        if self.faults.silent:
            return b""
        return uart.take(data, start, sent, heard)

    def _add_faults(self, data: bytes) -> bytes:
        """Return ``data`` with random transmission errors."""
        faults = self.faults
        if not (faults.drop or faults.insert or faults.flip) or not data:
            return data

        # Flip bits
        values = np.frombuffer(data, np.uint8)
        draws = self._rng.random((3, len(values)))
        bits = self._rng.integers(0, 8, len(values))
        values = np.where(draws[0] < faults.flip, values ^ (1 << bits), values).astype(np.uint8)

        # Drop and insert bytes
        repeats = np.where(draws[1] < faults.drop, 0, 1)
        extra = draws[2] < faults.insert
        junk = self._rng.integers(0, 256, len(values), dtype=np.uint8)
        pairs = np.stack([values, junk], axis=1).ravel()
        return np.repeat(pairs, np.stack([repeats, extra], axis=1).ravel()).tobytes()


class Wire:
    """A ``Transport`` to an emulated device in virtual time: reading advances the clock."""

    def __init__(self, device: Device | Line, clock: Clock, baud: int = 115200) -> None:
        """Open the client's end.

        Raises:
            LinkError: The line is unplugged.
        """
        self.line = device if isinstance(device, Line) else Line(device)
        self._clock = clock
        self._baud = baud
        self._open = True
        self.line.open(clock.now())

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``."""
        deadline = self._clock.now() + timeout
        while True:
            now = self._now()
            data = self.line.receive(now, self._baud)
            if data or now >= deadline - 1e-9:
                return data
            # The emulated base reports hazards in bytes.
            with suppress(HazardError):
                self._clock.sleep(min(POLL, deadline - now))

    def write(self, data: bytes) -> None:
        """See ``Transport.write``."""
        self.line.send(data, self._now(), self._baud)

    def set_baud(self, baud: int) -> None:
        """See ``Transport.set_baud``."""
        self._now()
        self._baud = baud

    def set_dtr(self, on: bool) -> None:
        """See ``Transport.set_dtr``; for a device that has ``set_dtr`` itself."""
        now = self._now()
        if hasattr(self.line.device, "set_dtr"):
            self.line.device.set_dtr(on, now)

    def discard_input(self) -> None:
        """See ``Transport.discard_input``."""
        self.line.discard(self._now(), self._baud)

    def close(self) -> None:
        """See ``Transport.close``."""
        self._open = False

    def _now(self) -> float:
        if not (self._open and self.line.plugged):
            raise LinkError("the wire was unplugged: check the cable and the power")
        return self._clock.now()
