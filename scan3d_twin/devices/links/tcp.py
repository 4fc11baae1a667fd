"""A TCP port in front of an emulated device: one client, no bit rate."""

from __future__ import annotations

import socket
from contextlib import suppress

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.links.line_model import Line

_CHUNK = 4096
_ANY_BAUD = 0


class TcpPort:
    """The port of a line, at ``path`` (``socket://127.0.0.1:PORT``).

    It serves one client at a time; another one waits until the first has disconnected. Bytes for a
    client that does not read are lost.

    Attributes:
        path: URL for the client.
    """

    def __init__(self, line: Line, host: str = "127.0.0.1", port: int = 0) -> None:
        """Start to listen.

        Args:
            line: The line to the emulated device.
            host: Address to listen on.
            port: Port number; 0 is any free port.

        Raises:
            LinkError: The address is in use or not available.
        """
        self._line = line
        try:
            self._server = socket.create_server((host, port))
        except OSError as error:
            raise LinkError(f"cannot listen on {host}:{port}: {error.strerror}") from None
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self.path = "socket://{}:{}".format(*self._server.getsockname())

    def service(self, now: float) -> None:
        """Transfer the bytes of both directions up to ``now`` [s]."""
        if self._client is None:
            self._accept(now)
        self._line.send(self._read(), now, _ANY_BAUD)
        out = self._line.receive(now, _ANY_BAUD)
        if self._client is not None and out:
            with suppress(OSError):
                self._client.send(out)

    def close(self) -> None:
        """Disconnect the client and stop listening."""
        self._hang_up()
        self._server.close()

    def _accept(self, now: float) -> None:
        try:
            self._client, _ = self._server.accept()
        except BlockingIOError:
            return
        self._client.setblocking(False)
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with suppress(LinkError):
            self._line.open(now)

    def _read(self) -> bytes:
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
