"""Finding a Create on a serial line: its model, its baud rate, and how to read its sensors."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle, product
from typing import Protocol

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.hal import BaseSpec, Clock
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, Model, Op, StreamParser
from scan3d_twin.devices.create.packets import Mode, Packet, decode_packets, size_of
from scan3d_twin.devices.links.transport import Transport

log = logging.getLogger(__name__)

BAUDS = (115200, 57600, 19200)
"""Baud rates to try: Create 2, Create 1, and the slow one both can be switched to [bit/s]."""
MODE_SETTLE = 0.02
"""Time after a mode change during which bytes may be lost [s]; Hacking Roomba, page 26."""
BAUD_SETTLE = 0.1
"""Wait after a change of the baud rate [s]; Create Open Interface, page 8."""
CONNECT_TIMEOUT = 8.0
"""Time within which a base is found, even while it boots after a reset [s]; assumption."""
ANSWER_TIMEOUT = 0.15
"""Time-out for the first frames of a stream [s]: ten periods; assumption."""
POLL_PERIOD = 2 * oi.PERIOD
"""Time between two polls, used where the line is too slow for a stream [s]."""
POLL_TIMEOUT = 4 * oi.PERIOD
"""Time after which an unanswered poll is repeated [s]."""
HALF_DRIVE, HALF_ANYTHING = bytes(5), bytes(2 + 2 * 255)
"""Zeros that complete a command left unfinished by a killed client or a noisy line: a drive
command, or any command up to the longest song. 0 is no opcode, so surplus zeros are ignored."""

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
"""Encoder counts, on a Create 2 only."""
MOVED = (Packet.DISTANCE, Packet.ANGLE)
"""Distance and rotation since the last read, used on a Create 1."""

Values = dict[int, int]
"""Raw readings by packet id."""


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


def find_base(transport: Transport, clock: Clock) -> Contact:
    """Find the base on the line; afterwards it is in mode Passive and sends nothing.

    The base does not move.

    Raises:
        LinkTimeoutError: Nothing answers in the Open Interface at any baud rate.
        LinkError: The port is gone.
    """
    give_up = clock.now() + CONNECT_TIMEOUT
    # At a wrong baud rate the base may hear the start of a long command: complete it every 2nd time
    for pad, baud in cycle(product((HALF_DRIVE, HALF_ANYTHING), BAUDS)):
        if clock.now() > give_up:
            break

        # Start at this baud rate
        transport.set_baud(baud)
        clock.sleep(BAUD_SETTLE)
        transport.write(pad + oi.command(Op.START))
        clock.sleep(len(pad) * 10 / baud + MODE_SETTLE)

        # Check the reported mode
        mode = _read_mode(transport, clock)
        if mode is not None:
            contact = Contact(_detect_model(transport, clock), baud, mode - Mode.PASSIVE)
            log.info("found a %s at %d baud", contact.model.name, baud)
            return contact

    speeds = ", ".join(map(str, BAUDS))
    raise LinkTimeoutError(
        f"no Create answers at {speeds} baud: switch it on (Clean or Power button), check the "
        "cable; after days on the charger take its battery out for 10 s"
    )


def _read_mode(transport: Transport, clock: Clock) -> int | None:
    """Return the mode that the base reports after Start; None if there is no base."""
    # Silence a running stream
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    clock.sleep(2 * oi.PERIOD)
    transport.discard_input()

    # Stream the mode alone
    source = Stream(transport, [Packet.MODE])
    deadline = clock.now() + ANSWER_TIMEOUT
    while clock.now() < deadline:
        for values in source.take(transport.read(oi.PERIOD), clock.now()):
            if values[Packet.MODE] in (Mode.PASSIVE, Mode.PASSIVE + 1):
                return values[Packet.MODE]
    return None


def _detect_model(transport: Transport, clock: Clock) -> Model:
    """Return the generation of the base: only the Create 2 has encoder counts."""
    # Silence a running stream
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    clock.sleep(2 * oi.PERIOD)
    transport.discard_input()

    # Query the encoder counts
    transport.write(oi.query(COUNTS))
    deadline, answer = clock.now() + POLL_TIMEOUT, b""
    while (left := deadline - clock.now()) > 1e-6 and len(answer) < 4:
        answer += transport.read(left)
    return CREATE2 if len(answer) == 4 else CREATE1


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
    return COMMON + COUNTS if contact.model is CREATE2 else COMMON


def packets_at_rest(contact: Contact) -> tuple[Packet, ...]:
    """Return the packets that the driver reads at rest: on a Create 1 also packets 19 and 20.

    Each read resets those and drops their fractions, so they are not read while the base drives.
    """
    return (
        watched_packets(contact) if contact.model is CREATE2 else watched_packets(contact) + MOVED
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
        radius=0.165,  # create_robot URDF; both generations
        wheel_base=model.wheel_base_mm / 1000,
        wheel_diameter=diameter,
        counts_per_turn=whole_mm if model is CREATE1 else model.counts_per_turn,
        max_wheel_speed=oi.MAX_WHEEL_SPEED_MM / 1000,
        sample_period=oi.PERIOD if streams else POLL_PERIOD,
    )
