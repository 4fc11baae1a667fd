"""The serial line between an emulated device and its client: speed, buffers and faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.core.hal import Clock

BUFFER = 65536
"""Bytes the client's port keeps until they are read; more are lost. Assumption: Linux keeps up to
640 KiB behind its 4 KiB, adapters much less."""
BITS_PER_BYTE = 10
"""8N1: start bit, eight data bits, stop bit."""
POLL = 0.002
"""A reader in virtual time looks at the line this often [s]."""


class Device(Protocol):
    """An emulated device: bytes in, bytes out, on the simulated clock and nothing else.

    It may have an attribute ``began``: when it put the bytes from the last ``transmit`` on the line
    [s]. Otherwise that is when they were fetched, and looking late delays them.
    """

    @property
    def baud(self) -> int:
        """The speed of the next bytes from ``transmit``, else its UART's; 0: none (USB) [bit/s]."""
        ...

    def receive(self, data: bytes, now: float) -> None:
        """Take in ``data`` that arrived by ``now`` [s]."""
        ...

    def transmit(self, now: float) -> bytes:
        """Return bytes it has put on the line up to ``now`` [s] at one speed; b"" is all."""
        ...


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong on a line, drawn from its seed; applies to both directions.

    Attributes:
        drop: Probability that a byte is lost, 0..1.
        insert: Probability that a byte is followed by one that was never sent, 0..1.
        flip: Probability that one bit of a byte is turned over, 0..1.
        stalls: Stalls per second; nothing arrives meanwhile, and all of it afterwards.
        stall: Length of a stall [s].
        junk: Bytes that lie in the port when it is opened.
        silent: Whether a wrong speed yields nothing instead of garbage.
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
    """Bytes on their way at one speed; the first one starts at ``start`` [s]."""

    start: float
    baud: int
    data: bytes

    def arrived(self, now: float) -> int:
        """Return how many bytes are through."""
        if self.baud == 0:
            return len(self.data) if now >= self.start else 0
        # A nanosecond of mercy for the rounding of the clock.
        whole = int((now - self.start + 1e-9) * self.baud / BITS_PER_BYTE)
        return max(0, min(len(self.data), whole))

    @property
    def end(self) -> float:
        """When the last byte is through [s]."""
        return self.start + (len(self.data) * BITS_PER_BYTE / self.baud if self.baud else 0.0)


class Line:
    """A line to ``device``, on the simulated clock.

    Attributes:
        faults: May be changed while it runs.
        plugged: Whether bytes pass at all.
        passed: Bytes that have reached the client, faults included.
    """

    def __init__(self, device: Device, faults: Faults = NO_FAULTS, seed: int = 0) -> None:
        self.device = device
        self.faults = faults
        self.plugged = True
        self.passed = 0
        self._rng = np.random.default_rng(seed)
        self._up: deque[_Burst] = deque()
        self._down: deque[_Burst] = deque()
        self._free_at = 0.0
        self._arrived = bytearray()
        self._stalled_until = 0.0
        self._looked = 0.0

    def open(self, now: float) -> None:
        """A client opens its end; what the device said before is lost.

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
        """The client forgets what has arrived."""
        self.receive(now, baud)

    def send(self, data: bytes, now: float, baud: int) -> None:
        """The client sends ``data`` at ``baud`` [bit/s]; 0 is any speed."""
        self._pull(now, baud)
        if self.plugged and data:
            speed = self.device.baud
            start = max([now, *(burst.end for burst in self._up)])
            heard = self._faulty(self._heard(data, baud, speed))
            self._up.append(_Burst(start, baud if speed else 0, heard))
            self._push(now)

    def receive(self, now: float, baud: int) -> bytes:
        """Return what has arrived by ``now`` [s] at a client that listens at ``baud``."""
        self._pull(now, baud)
        data = bytes(self._arrived)
        self._arrived.clear()
        return data

    def _push(self, now: float) -> None:
        """Hand the device what has reached it, each piece at its time."""
        while self._up and self._up[0].end <= now + 1e-9:
            burst = self._up.popleft()
            self.device.receive(burst.data, max(burst.end, self._looked))

    def _pull(self, now: float, baud: int) -> None:
        """Let bytes pass in both directions up to ``now``."""
        self._push(now)
        speed = self.device.baud
        while data := self.device.transmit(now):
            self._free_at = max(getattr(self.device, "began", now), self._free_at)
            self._down.append(_Burst(self._free_at, speed, data))
            self._free_at = self._down[-1].end
            speed = self.device.baud
        if not self.plugged:
            self._down.clear()
        if not self._stalled(now):
            for data, speed in self._through(now):
                self._keep(self._faulty(self._heard(data, speed, baud)))
        self._looked = now

    def _through(self, now: float) -> Iterator[tuple[bytes, int]]:
        while self._down and (count := self._down[0].arrived(now)):
            burst = self._down.popleft()
            yield burst.data[:count], burst.baud
            if count < len(burst.data):
                rest = burst.data[count:]
                start = burst.start + count * BITS_PER_BYTE / burst.baud
                self._down.appendleft(_Burst(start, burst.baud, rest))
                return

    def _keep(self, data: bytes) -> None:
        self.passed += len(data)
        self._arrived += data[: BUFFER - len(self._arrived)]

    def _stalled(self, now: float) -> bool:
        expected = self.faults.stalls * (now - self._looked)
        if now >= self._stalled_until and expected > 0 and self._rng.random() < expected:
            self._stalled_until = now + self.faults.stall
        return now < self._stalled_until

    def _heard(self, data: bytes, sent: int, heard: int) -> bytes:
        """Return what a UART at ``heard`` baud makes of ``data`` sent at ``sent`` baud."""
        if sent == heard or not sent or not heard:
            return data
        if self.faults.silent:
            return b""
        # A slower UART takes several bytes for one; a faster one sees a break or two in each.
        return self._rng.bytes(round(len(data) * min(2.0, heard / sent)))

    def _faulty(self, data: bytes) -> bytes:
        faults = self.faults
        if not (faults.drop or faults.insert or faults.flip) or not data:
            return data
        values = np.frombuffer(data, np.uint8)
        draws = self._rng.random((3, len(values)))
        bits = self._rng.integers(0, 8, len(values))
        values = np.where(draws[0] < faults.flip, values ^ (1 << bits), values).astype(np.uint8)
        repeats = np.where(draws[1] < faults.drop, 0, 1)
        extra = draws[2] < faults.insert
        junk = self._rng.integers(0, 256, len(values), dtype=np.uint8)
        pairs = np.stack([values, junk], axis=1).ravel()
        return np.repeat(pairs, np.stack([repeats, extra], axis=1).ravel()).tobytes()


class Wire:
    """A ``Transport`` to an emulated device in virtual time: who reads lets the clock run."""

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
            # What happens in the world is the emulated device's to tell, in bytes.
            with suppress(HazardError):
                self._clock.sleep(min(POLL, deadline - now))

    def write(self, data: bytes) -> None:
        """See ``Transport.write``."""
        self.line.send(data, self._now(), self._baud)

    def set_baud(self, baud: int) -> None:
        """See ``Transport.set_baud``."""
        self._now()
        self._baud = baud

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
