"""Requests to an URG-04LX and their replies, without blocking."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from scan3d_twin.core.errors import LinkTimeoutError, ProtocolError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.reconnecting import Steps, T, wait
from scan3d_twin.devices.urg.codec import Request
from scan3d_twin.devices.urg.replies import Block, Reply, Splitter, decode_reply, find_echo

TIMEOUT = 0.45
"""Time-out for the answer to a request [s]: the tick of 0.1 s, 0.11 s for the longest answer at
19200 baud, and a margin for a busy host; three attempts fit into the time-out for connecting."""
ATTEMPTS = 3
"""Number of times that a request is sent before giving up."""


@dataclass(frozen=True, slots=True)
class Arrived:
    """A block that has arrived.

    Attributes:
        block: Its lines.
        began: Arrival time of its first byte [s].
        ended: Arrival time of its last byte [s].
        is_cut: Whether its start may have been discarded.
    """

    block: Block
    began: float
    ended: float
    is_cut: bool = False

    def reply(self, echo: str) -> tuple[Reply, float]:
        """Return the reply to ``echo`` in the block, and the time it began to arrive [s].

        Raises:
            ProtocolError: There is no such reply.
        """
        block = find_echo(self.block, echo)
        # If other lines precede the echo, only the arrival of the end is known.
        return decode_reply(block), self.began if len(block) == len(self.block) else self.ended


class UrgLink:
    """A transport whose incoming bytes are split into blocks.

    Attributes:
        clock: The robot's clock.
        baud: Bit rate [bit/s].
        heard_at: Time at which the last byte had arrived [s].
    """

    def __init__(self, transport: Transport, clock: Clock, baud: int) -> None:
        self.clock = clock
        self.baud = baud
        self.heard_at = clock.now()
        self._transport = transport
        self._splitter = Splitter()
        self._began = clock.now()
        self._is_cut = False
        self._blocks: deque[Arrived] = deque()

    def pump(self, timeout: float = 0.0) -> None:
        """Take in what has arrived, waiting up to ``timeout`` [s] for it.

        Raises:
            LinkError: The sensor is unplugged.
        """
        data = self._transport.read(timeout)
        now = self.clock.now()
        if data:
            self.heard_at = now
        if self._splitter.is_empty:
            self._began = now
        for block in self._splitter.feed(data):
            self._blocks.append(Arrived(block, self._began, now, self._is_cut))
            self._began, self._is_cut = now, False

    def take(self) -> Iterator[Arrived]:
        """Yield the blocks that have arrived, without waiting, and remove them.

        Raises:
            LinkError: The sensor is unplugged.
        """
        self.pump()
        while self._blocks:
            yield self._blocks.popleft()

    @property
    def unfinished(self) -> Block:
        """The complete lines of the block that is still arriving."""
        return self._splitter.lines

    def send(self, data: bytes) -> None:
        """Send ``data``."""
        self._transport.write(data)

    def set_baud(self, baud: int) -> None:
        """Change the host's bit rate and discard what has arrived.

        Raises:
            LinkError: The port does not support it.
        """
        self._transport.set_baud(baud)
        self.baud = baud
        self.forget()

    def forget(self) -> None:
        """Discard what has arrived."""
        self._transport.discard_input()
        self._splitter.reset()
        self._blocks.clear()
        self._is_cut = True

    def ask(
        self, request: Request, decode: Callable[[Reply], T], attempts: int = ATTEMPTS
    ) -> Steps[tuple[T, float]]:
        """Send ``request``; return its decoded reply and the time that began to arrive [s].

        Args:
            request: The request.
            decode: Decodes the reply; a reply for which it raises ``ProtocolError`` is skipped.
            attempts: Number of times the request is sent.

        Raises:
            LinkTimeoutError: The sensor does not answer.
            LinkError: The sensor is unplugged.
        """
        for _ in range(attempts):
            self.send(request.encode())
            deadline = self.clock.now() + TIMEOUT
            while self.clock.now() < deadline:
                for arrived in self.take():
                    try:
                        reply, began = arrived.reply(request.echo)
                        return decode(reply), began
                    except ProtocolError:
                        continue
                yield
        raise LinkTimeoutError(f"the lidar does not answer {request.echo} at {self.baud} baud")

    def wait(self, seconds: float) -> Steps[None]:
        """Let ``seconds`` pass."""
        yield from wait(self.clock, seconds)
