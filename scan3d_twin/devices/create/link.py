"""Finding a Create on a serial line, and what to ask of it: model, speed, stream or poll."""

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
"""Speeds to try: Create 2, Create 1, and the slow one that both can be switched to [bit/s]."""
MODE_SETTLE = 0.02
"""Bytes within this time of a change of mode may be lost [s]; Hacking Roomba, page 26."""
BAUD_SETTLE = 0.1
"""Wait after a change of speed [s]; Create Open Interface, page 8."""
CONNECT_TIMEOUT = 8.0
"""A base that boots after a reset is ready by then [s]; assumption."""
ANSWER_TIMEOUT = 0.15
"""For the first frames of a stream [s]: ten periods; assumption."""
POLL_PERIOD = 2 * oi.PERIOD
"""Time between two polls where a stream does not fit [s]."""
POLL_TIMEOUT = 4 * oi.PERIOD
"""A poll not answered by then is asked again [s]."""
HALF_DRIVE, HALF_ANYTHING = bytes(5), bytes(2 + 2 * 255)
"""Zeros that end what a killed client or a bad line left half sent: a drive command, or even the
longest song; 0 is no opcode."""

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
"""What the driver watches on every base."""
COUNTS = (Packet.LEFT_COUNTS, Packet.RIGHT_COUNTS)
MOVED = (Packet.DISTANCE, Packet.ANGLE)

Values = dict[int, int]
"""Readings by packet id, raw."""


@dataclass(frozen=True, slots=True)
class Contact:
    """A base that answered.

    Attributes:
        model: Its generation.
        baud: The speed it talks at [bit/s].
        mode_offset: What it adds to the mode it reports; 1 on some firmware.
    """

    model: Model
    baud: int
    mode_offset: int


def find_base(transport: Transport, clock: Clock) -> Contact:
    """Return what base is on the line, in mode Passive and silent; it does not move.

    Raises:
        LinkTimeoutError: Nothing that talks the Open Interface answers at any speed.
        LinkError: The port is gone.
    """
    give_up = clock.now() + CONNECT_TIMEOUT
    # What is sent at a wrong speed may be heard as half of a long command: end that every 2nd time.
    for pad, baud in cycle(product((HALF_DRIVE, HALF_ANYTHING), BAUDS)):
        if clock.now() > give_up:
            break
        transport.set_baud(baud)
        clock.sleep(BAUD_SETTLE)
        transport.write(pad + oi.command(Op.START))
        clock.sleep(len(pad) * 10 / baud + MODE_SETTLE)
        mode = _reported_mode(transport, clock)
        if mode is not None:
            contact = Contact(_model(transport, clock), baud, mode - Mode.PASSIVE)
            log.info("found a %s at %d baud", contact.model.name, baud)
            return contact
    speeds = ", ".join(map(str, BAUDS))
    raise LinkTimeoutError(
        f"no Create answers at {speeds} baud: switch it on (Clean or Power button), check the "
        "cable; after days on the charger take its battery out for 10 s"
    )


def _reported_mode(transport: Transport, clock: Clock) -> int | None:
    """Return the mode that the base reports after Start; None if there is no base."""
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    clock.sleep(2 * oi.PERIOD)
    transport.discard_input()
    source = Stream(transport, [Packet.MODE])
    deadline = clock.now() + ANSWER_TIMEOUT
    while clock.now() < deadline:
        for values in source.take(transport.read(oi.PERIOD), clock.now()):
            if values[Packet.MODE] in (Mode.PASSIVE, Mode.PASSIVE + 1):
                return values[Packet.MODE]
    return None


def _model(transport: Transport, clock: Clock) -> Model:
    """Tell the generations apart: only the later one has encoder counts."""
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    clock.sleep(2 * oi.PERIOD)
    transport.discard_input()
    transport.write(oi.query(COUNTS))
    deadline, answer = clock.now() + POLL_TIMEOUT, b""
    while (left := deadline - clock.now()) > 1e-6 and len(answer) < 4:
        answer += transport.read(left)
    return CREATE2 if len(answer) == 4 else CREATE1


class Source(Protocol):
    """Where readings come from."""

    @property
    def bad(self) -> int:
        """Number of broken answers so far."""
        ...

    @property
    def broken(self) -> int:
        """Number of signs so far that bytes are garbled on the way."""
        ...

    def take(self, data: bytes, now: float) -> list[Values]:
        """Return the readings that ``data``, arrived by ``now`` [s], completes, oldest first."""
        ...


def open_source(
    transport: Transport, contact: Contact, packets: Sequence[int], header_summed: bool | None
) -> Source:
    """Ask for ``packets`` for good: as a stream if a frame fits into 15 ms, else by polling."""
    if oi.fits(packets, contact.baud):
        return Stream(transport, packets, header_summed)
    transport.write(oi.command(Op.PAUSE_RESUME, 0))
    return Poll(transport, packets)


class Stream:
    """The base sends by itself, with a checksum."""

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
    def broken(self) -> int:
        """Bytes that made no sense, once the base's checksum is known."""
        return self._parser.skipped - self._before_lock

    @property
    def header_summed(self) -> bool | None:
        """Which checksum the base uses, once known."""
        return self._parser.header_summed

    def take(self, data: bytes, now: float) -> list[Values]:
        """See ``Source.take``."""
        values = self._parser.feed(data)
        if not (values or self._heard):
            self._before_lock = self._parser.skipped
        self._heard = self._heard or bool(values)
        return values


class Poll:
    """The driver asks, the base answers without a checksum; for slow lines."""

    @property
    def broken(self) -> int:
        """Answers that were too long or too late."""
        return self.bad

    def __init__(self, transport: Transport, packets: Sequence[int]) -> None:
        self.bad = 0
        self._transport = transport
        self._packets = packets
        self._size = sum(map(size_of, packets))
        self._answer = b""
        self._asked: float | None = None
        self._next: float | None = None

    def take(self, data: bytes, now: float) -> list[Values]:
        """See ``Source.take``."""
        if self._next is None:
            self._next = now + POLL_TIMEOUT  # by then the line is quiet
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
        late = self._asked is not None and now - self._asked > POLL_TIMEOUT
        self.bad += late
        if late or (self._asked is None and now >= self._next):
            self._transport.discard_input()
            self._transport.write(oi.query(self._packets))
            self._answer, self._asked = b"", now
        return values


def watched(contact: Contact) -> tuple[Packet, ...]:
    """Return the packets the driver wants from this base all the time."""
    return COMMON + COUNTS if contact.model is CREATE2 else COMMON


def at_rest(contact: Contact) -> tuple[Packet, ...]:
    """Return the packets the driver wants while the base stands: on a Create 1 also how far it got.

    Reading those begins them anew without their fractions, so they are not read while it drives.
    """
    return watched(contact) if contact.model is CREATE2 else watched(contact) + MOVED


def plausible(values: Values, contact: Contact) -> bool:
    """Tell whether readings can be true at all; for what a checksum lets through."""
    limits: dict[int, Callable[[int], bool]] = {
        Packet.BUMPS_DROPS: lambda v: v < 32,
        Packet.OVERCURRENTS: lambda v: v < 32,
        Packet.CHARGING_SOURCES: lambda v: v < 4,
        Packet.MODE: lambda v: 0 <= v - contact.mode_offset <= Mode.FULL,
        Packet.REQUESTED_RIGHT: lambda v: abs(v) <= oi.MAX_WHEEL_SPEED_MM,
        Packet.REQUESTED_LEFT: lambda v: abs(v) <= oi.MAX_WHEEL_SPEED_MM,
        **dict.fromkeys(range(Packet.CLIFF_LEFT, Packet.VIRTUAL_WALL), lambda v: v < 2),
    }
    return all(limits[packet](value) for packet, value in values.items() if packet in limits)


def base_spec(model: Model, *, streams: bool) -> BaseSpec:
    """Return what a base of that generation can do, which streams or is polled."""
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
