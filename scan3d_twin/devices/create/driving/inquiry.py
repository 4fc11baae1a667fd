"""Asking a base for its readings until it answers, at whatever baud rate it listens.

A standing base that is silent may have missed a request, have taken noise for a command, sleep, or
listen at another baud rate; each is tried in turn.
"""

from __future__ import annotations

import math
from dataclasses import replace

from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Op
from scan3d_twin.devices.create.link import (
    BAUDS,
    HALF_ANYTHING,
    HALF_DRIVE,
    Contact,
    Source,
    Stream,
    Values,
    call_back,
    open_source,
)
from scan3d_twin.devices.create.packets import Packet
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport

ASK_AGAIN = 0.1
"""Time between two requests, and between two repetitions of a drive command [s]."""
LOST_AFTER = 1.0
"""Silence of a driving base after which the link counts as lost [s]. If the base answers earlier,
only the computer or the cable was busy, and it drives on; assumption. Bytes that arrive from a base
that was called back are a sign of life, for up to ``FRAME_AT_LOWEST`` more."""
SILENCE_AT_REST = 3.0
"""Silence of a standing base after which the link counts as lost [s]; until then the driver keeps
requesting the stream."""
FRAME_AT_LOWEST = 1.5
"""Time that a base called back from 300 bit/s may take to send the frame that it had begun [s]: 45
bytes."""
KEEP_AWAKE = 60.0
"""Time after which a base in Passive is sent its request again [s]: a Create 2 falls asleep after
five minutes without a command (manual); that a request counts as one is an assumption."""
GRACE = 0.15
"""Silence that a base has at most behind it right after a request for other packets [s]."""
CALL_AFTER_ASKS = 4
"""Unanswered requests before a standing base is called back from 300 bit/s."""
ASKS_AT_ONE_SPEED = 10
"""Unanswered requests before other baud rates are tried: noise may have changed the base's."""


class Inquiry:
    """Requests packets from a base and takes in what arrives.

    Attributes:
        contact: Model and baud rate of the base.
        packets: What was requested.
        requested_at: Time of the latest request [s].
        again_at: Time before which nothing is to be repeated [s].
        heard: Time of the latest reading that was believed [s]; time in which nobody listened does
            not count as silence, and shifts it.
        stirred: Time at which a base that was called back last sent anything [s]; shifted alike.
        has_called: Whether the base was called back since the latest reading.
    """

    def __init__(self, transport: Transport, clock: Clock, contact: Contact) -> None:
        self.contact = contact
        self.packets: tuple[Packet, ...] = ()
        self.heard = clock.now()
        self.requested_at = self.again_at = self.stirred = -math.inf
        self.has_called = False
        self._transport, self._clock = transport, clock
        self._header_summed: bool | None = None
        self._is_calling_back = False
        self._asks = 0
        self._source: Source | None = None

    @property
    def source(self) -> Source:
        """The source of readings that is open."""
        assert self._source is not None, "nothing was requested yet"
        return self._source

    @property
    def streams(self) -> bool:
        """Whether the base streams its readings or is polled."""
        return isinstance(self._source, Stream)

    @property
    def is_calling_back(self) -> bool:
        """Whether the line is at 300 bit/s, where the base hears no other command."""
        return self._is_calling_back

    def ask(self, packets: tuple[Packet, ...]) -> None:
        """Request ``packets``; the base gets time to answer."""
        self.packets, self.requested_at = packets, self._clock.now()
        self.heard = max(self.heard, self.requested_at - GRACE)
        self._source = open_source(self._transport, self.contact, packets, self._header_summed)

    def ask_anew(self) -> None:
        """Request the same packets; unlike ``ask``, this does not extend the time-out."""
        heard = self.heard
        self.ask(self.packets)
        self.heard = heard

    def read(self, now: float) -> list[Values]:
        """Return the readings that have arrived by ``now`` [s], oldest first."""
        data = self._transport.read(0.0)
        if data and self.has_called:
            self.stirred = now
        return self.source.take(data, now)

    def note_deaf(self, seconds: float, now: float) -> None:
        """Note that nobody listened for ``seconds`` before ``now`` [s]: that was no silence."""
        self.heard = min(now, self.heard + seconds)
        self.stirred = min(now, self.stirred + seconds)

    def note_reading(self, now: float) -> None:
        """Note that a reading of ``now`` [s] was believed."""
        self.heard, self._asks, self.has_called = now, 0, False
        if isinstance(self._source, Stream):
            self._header_summed = self._source.header_summed

    def is_lost(self, now: float, moving: bool) -> bool:
        """Return whether the base has been silent for too long, while ``moving`` or at rest.

        A driving base that was called back may still send, at another rate, what it had begun.
        """
        silent = now - self.heard
        if not moving:
            return silent > SILENCE_AT_REST
        dead = min(silent, now - self.stirred)
        return dead > LOST_AFTER or silent > LOST_AFTER + FRAME_AT_LOWEST

    def call_back(self, now: float) -> None:
        """Order the base back from the rate that a garbled byte may have sent it to."""
        self._is_calling_back = self.has_called = True
        self.again_at = now + call_back(self._transport, self.contact.baud)

    def return_to_baud(self) -> None:
        """Speak again as before the base was called back."""
        if self._is_calling_back:
            self._is_calling_back = False
            self._transport.set_baud(self.contact.baud)

    def wake(self, now: float) -> None:
        """Wake up a standing base that is silent: it may have missed or misread any command."""
        # Call it back once, between two requests
        if self._asks == CALL_AFTER_ASKS and not self.has_called:
            self.call_back(now)
            return
        self.return_to_baud()

        # Choose padding and baud rate
        self._asks += 1
        pad = HALF_ANYTHING
        if self._asks > ASKS_AT_ONE_SPEED:
            pad = HALF_DRIVE
            speed = BAUDS[(BAUDS.index(self.contact.baud) + 1) % len(BAUDS)]
            self.contact = replace(self.contact, baud=speed)
            self._transport.set_baud(speed)

        # Start and request the packets
        self._transport.write(pad + oi.command(Op.START))
        self.ask_anew()
        self.again_at = now + ASK_AGAIN + self.transfer_time(len(pad))

    def complete_command(self) -> float:
        """Send what completes any command, and ask anew; return how long the zeros take [s]."""
        self._transport.write(HALF_ANYTHING)
        self.ask_anew()
        return self.transfer_time(len(HALF_ANYTHING))

    def keep_awake(self, now: float) -> None:
        """Request the stream once more if a base would fall asleep; it goes on meanwhile."""
        if now - self.requested_at > KEEP_AWAKE and self.streams:
            self._transport.write(oi.stream(self.packets))
            self.requested_at = now

    def transfer_time(self, size: int) -> float:
        """Return how long ``size`` bytes are on the line, in s."""
        return size * BITS_PER_BYTE / self.contact.baud
