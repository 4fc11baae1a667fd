"""Reading the sensors of a Create: which packets, and as a stream or by polling."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Model, Op, StreamParser
from scan3d_twin.devices.create.packets import Mode, Packet, decode_packets, size_of
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport

BAUDS = (115200, 57600, 19200)
"""Baud rates to try: Create 2, Create 1, and the slow one both can be switched to [bit/s]."""
MODE_SETTLE = 0.021
"""Time after a mode change during which bytes may be lost [s]: 20 ms (Hacking Roomba, page 26), and
a margin of 1 ms."""
POLL_PERIOD = 2 * oi.PERIOD
"""Time between two polls, used where the line is too slow for a stream [s]."""
POLL_TIMEOUT = 4 * oi.PERIOD
"""Time after which an unanswered poll is repeated [s]."""
HALF_DRIVE, HALF_STREAM, HALF_ANYTHING = bytes(5), bytes(2 + 3 + 128), bytes(2 + 2 * 255)
"""Zeros that complete a command left unfinished by a killed client or a noisy line: a drive
command; a request for 3 packets whose number has a wrong bit; any command up to the longest song. 0
is no opcode, so surplus zeros are ignored."""

BAUD_SETTLE = 0.1
"""Time after a change of the baud rate until the base listens at it [s]; manual, page 8."""

COMMON = (
    Packet.BUMPS_DROPS,
    Packet.CLIFF_LEFT,
    Packet.CLIFF_FRONT_LEFT,
    Packet.CLIFF_FRONT_RIGHT,
    Packet.CLIFF_RIGHT,
    Packet.OVERCURRENTS,
    Packet.VOLTAGE,
    Packet.CHARGE,
    Packet.CAPACITY,
    Packet.CHARGING_SOURCES,
    Packet.MODE,
    Packet.REQUESTED_RIGHT,
    Packet.REQUESTED_LEFT,
)
"""Packets the driver reads on every base."""
COUNTS = (Packet.LEFT_COUNTS, Packet.RIGHT_COUNTS)
"""Encoder counts, on a Create 2 or Roomba only."""
MOVED = (Packet.DISTANCE, Packet.ANGLE)
"""Distance and rotation since the last read, used on a Create 1."""

Values = dict[int, int]
"""Raw readings by packet id."""


def call_back(transport: Transport, baud: int) -> float:
    """Order a base that listens at 300 bit/s back to ``baud``; the line is left at 300 bit/s.

    Code 0 of the command for another rate is 300 bit/s, and most bytes on the line are zeros: a
    base that takes a garbled byte for that command nearly always listens there. One that does not
    reads zeros and line errors.

    Returns:
        Time from now until the base listens at ``baud`` [s].
    """
    lowest = oi.BAUD_CODES[0]
    order = oi.command(Op.BAUD, oi.BAUD_CODES.index(baud))
    transport.set_baud(lowest)
    transport.write(order)
    return len(order) * BITS_PER_BYTE / lowest + BAUD_SETTLE


@dataclass(frozen=True, slots=True)
class Contact:
    """A base that answered.

    Attributes:
        model: Its generation.
        baud: Its baud rate [bit/s].
        mode_offset: Added to the mode it reports; 1 on some firmware.
    """

    model: Model
    baud: int
    mode_offset: int


class Source(Protocol):
    """A source of readings: the stream of the base, or polling."""

    @property
    def bad(self) -> int:
        """Number of answers that arrived damaged."""
        ...

    @property
    def errors(self) -> int:
        """Number of transmission errors detected."""
        ...

    def take(self, data: bytes, now: float) -> list[Values]:
        """Return the readings completed by ``data``, which arrived by ``now`` [s], oldest first."""
        ...


def open_source(
    transport: Transport, contact: Contact, packets: Sequence[int], header_summed: bool | None
) -> Source:
    """Read ``packets`` from now on: as a stream if a frame fits into 15 ms, else by polling.

    Args:
        transport: The line to the base.
        contact: The base.
        packets: Packets to read.
        header_summed: Whether its checksum covers the header; None if that is not known yet.
    """
    if oi.fits_stream(packets, contact.baud):
        return Stream(transport, packets, header_summed)
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    return Poll(transport, packets)


class Stream:
    """A ``Source``: the base streams its readings, protected by a checksum."""

    def __init__(
        self, transport: Transport, packets: Sequence[int], header_summed: bool | None = None
    ) -> None:
        self._parser = StreamParser(packets)
        self._parser.header_summed = header_summed
        self._heard = False
        self._before_lock = 0
        transport.write(oi.stream(packets))

    @property
    def bad(self) -> int:
        """Frames with a wrong checksum."""
        return self._parser.bad

    @property
    def errors(self) -> int:
        """Bytes that belonged to no frame, since the first good one."""
        return self._parser.skipped - self._before_lock

    @property
    def header_summed(self) -> bool | None:
        """Whether the checksum covers the header; None until that is known."""
        return self._parser.header_summed

    def take(self, data: bytes, now: float) -> list[Values]:
        """See ``Source.take``."""
        values = self._parser.feed(data)
        if not (values or self._heard):
            self._before_lock = self._parser.skipped
        self._heard = self._heard or bool(values)
        return values


class Poll:
    """A ``Source`` for slow lines: the driver polls, the base answers without a checksum.

    Attributes:
        bad: Answers that were too long or too late.
    """

    def __init__(self, transport: Transport, packets: Sequence[int]) -> None:
        self.bad = 0
        self._transport = transport
        self._packets = packets
        self._size = sum(map(size_of, packets))
        self._answer = b""
        self._asked: float | None = None
        self._next: float | None = None

    @property
    def errors(self) -> int:
        """See ``Source.errors``: an answer of the wrong size is the only sign of an error."""
        return self.bad

    def take(self, data: bytes, now: float) -> list[Values]:
        """See ``Source.take``."""
        # Begin once the line is quiet
        if self._next is None:
            self._next = now + POLL_TIMEOUT

        # Decode a complete answer
        self._answer += data
        values = []
        if self._asked is not None and len(self._answer) >= self._size:
            if len(self._answer) == self._size:
                values = [decode_packets(self._packets, self._answer)]
            else:
                self.bad += 1
            self._answer = b""
            self._next = self._asked + POLL_PERIOD
            self._asked = None

        # Poll again when due
        late = self._asked is not None and now - self._asked > POLL_TIMEOUT
        self.bad += late
        if late or (self._asked is None and now >= self._next):
            self._transport.discard_input()
            self._transport.write(oi.query(self._packets))
            self._answer, self._asked = b"", now
        return values


def watched_packets(contact: Contact) -> tuple[Packet, ...]:
    """Return the packets that the driver reads from this base at all times."""
    return COMMON + COUNTS if contact.model.has_counts else COMMON


def packets_at_rest(contact: Contact) -> tuple[Packet, ...]:
    """Return the packets that the driver reads at rest: on a Create 1 also packets 19 and 20.

    Each read resets those and drops their fractions, so they are not read while the base drives.
    """
    return (
        watched_packets(contact) if contact.model.has_counts else watched_packets(contact) + MOVED
    )


def is_plausible(values: Values, contact: Contact) -> bool:
    """Return whether all readings are in range; catches errors that the checksum misses."""
    return not find_implausible(values, contact)


def find_implausible(values: Values, contact: Contact) -> Values:
    """Return the readings that are out of range."""
    limits: dict[int, Callable[[int], bool]] = {
        Packet.BUMPS_DROPS: lambda v: v < 32,
        Packet.OVERCURRENTS: lambda v: v < 32,
        Packet.CHARGING_SOURCES: lambda v: v < 4,
        Packet.MODE: lambda v: 0 <= v - contact.mode_offset <= Mode.FULL,
        Packet.REQUESTED_RIGHT: lambda v: abs(v) <= oi.MAX_WHEEL_SPEED_MM,
        Packet.REQUESTED_LEFT: lambda v: abs(v) <= oi.MAX_WHEEL_SPEED_MM,
        **dict.fromkeys(range(Packet.CLIFF_LEFT, Packet.VIRTUAL_WALL), lambda v: v < 2),
    }
    return {
        packet: value
        for packet, value in values.items()
        if packet in limits and not limits[packet](value)
    }


def base_spec(model: Model, *, streams: bool) -> BaseSpec:
    """Return the data sheet of a base of this generation.

    Args:
        model: Generation of the base.
        streams: Whether it streams its readings every 15 ms or is polled.
    """
    diameter = model.wheel_diameter_mm / 1000
    # Packet 19 of a Create 1 counts whole millimetres.
    whole_mm = math.pi * model.wheel_diameter_mm
    return BaseSpec(
        name=model.name,
        radius=model.radius_mm / 1000,
        wheel_base=model.wheel_base_mm / 1000,
        wheel_diameter=diameter,
        counts_per_turn=model.counts_per_turn if model.has_counts else whole_mm,
        max_wheel_speed=oi.MAX_WHEEL_SPEED_MM / 1000,
        sample_period=oi.PERIOD if streams else POLL_PERIOD,
        min_wheel_speed=model.min_speed_mm / 1000,
    )
