"""Requests to an RPLIDAR and their replies, without blocking."""

from __future__ import annotations

from collections.abc import Callable

from scan3d_twin.core.errors import LinkTimeoutError, ProtocolError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.reconnecting import Steps, T, wait
from scan3d_twin.devices.rplidar.codec import (
    DESCRIPTOR_LENGTH,
    REPLY_START,
    Command,
    Descriptor,
    ReplyType,
    decode_descriptor,
    encode_request,
)

TIMEOUT = 0.15
"""Time-out for the reply to a request [s]; assumption, the SDK waits 2 s. Twenty attempts fit into
the time-out for connecting."""
ATTEMPTS = 6
"""Number of times that a request is sent before giving up."""
QUIET = 0.1
"""Time after STOP in which the scan ends [s]: the SDK and rplidar-roboticia wait as long."""
MAX_STOPS = 8
"""Number of times that STOP is sent; together they are longer than what a usual request, cut off by
a dead client, may lack."""


class RplidarLink:
    """A transport to the lidar.

    Attributes:
        clock: The robot's clock.
        received: Number of bytes received.
        heard_at: Time at which the last byte had arrived [s].
    """

    def __init__(self, transport: Transport, clock: Clock) -> None:
        self.clock = clock
        self.received = 0
        self.heard_at = clock.now()
        self._transport = transport
        self._buffer = b""

    def pump(self, timeout: float = 0.0) -> None:
        """Take in what has arrived, waiting up to ``timeout`` [s] for it.

        Raises:
            LinkError: The lidar is unplugged.
        """
        data = self._transport.read(timeout)
        if data:
            self.received += len(data)
            self.heard_at = self.clock.now()
        self._buffer += data

    def take(self) -> bytes:
        """Return what has arrived, without waiting, and remove it."""
        self.pump()
        data, self._buffer = self._buffer, b""
        return data

    def forget(self) -> None:
        """Discard what has arrived."""
        self._transport.discard_input()
        self._buffer = b""

    def send(self, data: bytes) -> None:
        """Send ``data``."""
        self._transport.write(data)

    def set_dtr(self, on: bool) -> None:
        """Set the line DTR where the port has one."""
        self._transport.set_dtr(on)

    def wait(self, seconds: float) -> Steps[None]:
        """Let ``seconds`` pass."""
        yield from wait(self.clock, seconds)

    def stop_scan(self) -> Steps[bool]:
        """Send STOP until nothing arrives any more; return whether that was so."""
        for _ in range(MAX_STOPS):
            self.send(encode_request(Command.STOP))
            yield from self.wait(QUIET / 2)
            self.take()
            before = self.received
            yield from self.wait(QUIET / 2)
            self.take()
            if self.received == before:
                return True
        return False

    def ask(
        self,
        request: bytes,
        kind: ReplyType,
        decode: Callable[[bytes], T],
        attempts: int = ATTEMPTS,
    ) -> Steps[T]:
        """Send ``request``; return its decoded reply once two replies agree.

        Replies have no checksum, so that one alone is not believed.

        Args:
            request: The request.
            kind: Type of the reply.
            decode: Decodes its payload; one for which it raises ``ProtocolError`` is skipped.
            attempts: Number of times the request is sent.

        Raises:
            LinkTimeoutError: The lidar does not answer.
            LinkError: It is unplugged.
        """
        seen: list[T] = []
        for _ in range(attempts):
            self.send(request)
            try:
                payload = yield from self._reply(kind)
                value = decode(payload)
            except ProtocolError:
                continue
            if value in seen:
                return value
            seen.append(value)
        raise LinkTimeoutError(f"the lidar does not answer the request {request.hex(' ')}")

    def start(self, request: bytes, kind: ReplyType, length: int, timeout: float) -> Steps[None]:
        """Send a ``request`` for a stream of frames and wait for its descriptor.

        Raises:
            LinkTimeoutError: There is none.
            LinkError: The lidar is unplugged.
        """
        self.take()
        self.send(request)
        wanted = Descriptor(length, True, kind)
        deadline = self.clock.now() + timeout
        while self.clock.now() < deadline:
            self.pump()
            _, found, rest = self._buffer.partition(wanted.encode())
            if found:
                self._buffer = rest
                return
            yield
        raise LinkTimeoutError("the lidar does not start to scan")

    def _reply(self, kind: ReplyType) -> Steps[bytes]:
        """Return the payload of a single reply of a ``kind``.

        Raises:
            ProtocolError: There is none in time.
        """
        deadline = self.clock.now() + TIMEOUT
        while self.clock.now() < deadline:
            self.pump()
            at = self._buffer.find(REPLY_START)
            if at >= 0 and len(self._buffer) >= at + DESCRIPTOR_LENGTH:
                descriptor = self._descriptor(at)
                if descriptor is None or descriptor.is_stream or descriptor.type != kind:
                    self._buffer = self._buffer[at + 1 :]
                    continue
                begin = at + DESCRIPTOR_LENGTH
                if len(self._buffer) >= begin + descriptor.length:
                    payload = self._buffer[begin : begin + descriptor.length]
                    self._buffer = self._buffer[begin + descriptor.length :]
                    return payload
            yield
        self._buffer = b""
        raise ProtocolError("no reply in time")

    def _descriptor(self, at: int) -> Descriptor | None:
        try:
            return decode_descriptor(self._buffer[at : at + DESCRIPTOR_LENGTH])
        except ProtocolError:
            return None
