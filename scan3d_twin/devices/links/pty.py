"""A pseudo-terminal in front of an emulated device: its client sees a serial port."""

from __future__ import annotations

import array
import fcntl
import os
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scan3d_twin.core.errors import FileError, LinkError
from scan3d_twin.devices.links.line_model import Line

_TCGETS2 = 0x802C542A
"""ioctl that reads the settings with a numeric bit rate; Linux, asm-generic/ioctls.h."""
_SPEED_AT = 10
"""Index of the output speed in ``struct termios2``, in 32-bit words."""
_CHUNK = 4096


class PtyPort:
    """The port of a line, at ``path``.

    The client's bit rate is the one it sets on the terminal. Without a client the bytes are lost,
    as on a cable with an open end.

    Attributes:
        path: Path of the terminal for the client.
    """

    def __init__(self, line: Line) -> None:
        self._line = line
        self._master, slave = os.openpty()
        # Raw mode before anybody opens it: an echo would feed the device its own bytes.
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._connected = False

    @property
    def baud(self) -> int:
        """The client's bit rate [bit/s]."""
        settings = array.array("I", [0] * 16)
        fcntl.ioctl(self._master, _TCGETS2, settings)
        return settings[_SPEED_AT]

    def service(self, now: float) -> None:
        """Transfer the bytes of both directions up to ``now`` [s]."""
        data = self._read(now)
        # Read the bit rate after the bytes: a client writes first and then changes it.
        baud = self.baud
        self._line.send(data, now, baud)
        out = self._line.receive(now, baud)
        if self._connected and out:
            self._write(out)

    def close(self) -> None:
        """Close the port; its client sees it unplugged."""
        os.close(self._master)

    def _read(self, now: float) -> bytes:
        """Return what the client has sent; detect whether there is a client."""
        try:
            data = os.read(self._master, _CHUNK)
        except BlockingIOError:
            data = b""
        except OSError:  # nobody has the other end open
            self._connected = False
            return b""
        if not self._connected:
            self._connected = True
            with suppress(LinkError):
                self._line.open(now)
        return data

    def _write(self, data: bytes) -> None:
        # Bytes for a client that does not read, or is gone, are lost.
        with suppress(OSError):
            os.write(self._master, data)


@contextmanager
def linked(port: str, link: Path) -> Iterator[Path]:
    """Make ``link`` point to ``port`` for as long as it is served, in place of an older link.

    Raises:
        FileError: Something else is there, or the folder cannot be written.
    """
    if os.path.lexists(link) and not link.is_symlink():
        raise FileError(f"{link} is in the way and no link: choose another folder")
    try:
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(port)
    except OSError as error:
        raise FileError(f"cannot make the link {link}: {error.strerror}") from None
    try:
        yield link
    finally:
        # Another emulator may have taken over the name
        with suppress(OSError):
            if os.readlink(link) == port:
                link.unlink()
