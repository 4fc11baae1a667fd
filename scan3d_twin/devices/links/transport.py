"""Transports: bytes between a driver and its device, over a serial port or a socket."""

from __future__ import annotations

import errno
import fcntl
import grp
import logging
import os
import select
import stat
import termios
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, Protocol

import serial

from scan3d_twin.core.errors import LinkError
from scan3d_twin.core.hal import Clock

WRITE_TIMEOUT = 1.0
"""Time-out for sending a command, which has at most 100 bytes [s]."""
RETRY = (0.1, 0.25)
"""First and longest wait between two attempts to reopen a port [s]; it doubles each time. A base
whose cable came off drives on: half a second after it is back it must have been stopped."""
MEMORY_DEVICES = 1
"""Major number of /dev/null and its like; Linux, Documentation/admin-guide/devices.txt."""
_CHUNK = 4096

log = logging.getLogger(__name__)


class Transport(Protocol):
    """A line to a device."""

    def read(self, timeout: float) -> bytes:
        """Return what has arrived, waiting up to ``timeout`` [s] for the first byte; else ``b""``.

        Raises:
            LinkError: The device is unplugged.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data`` at once.

        Raises:
            LinkError: The device is unplugged.
        """
        ...

    def set_baud(self, baud: int) -> None:
        """Send and receive at ``baud`` [bit/s] from now on.

        Raises:
            LinkError: The port does not support it.
        """
        ...

    def set_dtr(self, on: bool) -> None:
        """Set the modem line DTR, with which some lidars switch their motor, where there is one.

        Set, it stays so after ``close``.

        Raises:
            LinkError: The device is unplugged.
        """
        ...

    def discard_input(self) -> None:
        """Discard what has arrived and was not read."""
        ...

    def close(self) -> None:
        """Close the port; closing twice does nothing."""
        ...


class SerialTransport:
    """A serial port, opened exclusively, or ``socket://HOST:PORT``.

    Modem control lines are used only by ``set_dtr``: pseudo-terminals and many adapters have none.

    Attributes:
        port: Path or URL of the port.
    """

    def __init__(self, port: str, baud: int = 115200) -> None:
        """Open ``port``.

        Raises:
            LinkError: It is missing, not permitted, in use or not a serial port; the message says
                what to do.
        """
        self.port = port
        # Before opening it: neither a lock nor TIOCEXCL keeps out who has it open already
        if others := holders(port):
            raise LinkError(_name_holders(port, others))
        try:
            self._serial = serial.serial_for_url(port, baud, timeout=0, **_options(port))
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(_explain_open_error(port, error)) from None
        with suppress(OSError):
            fcntl.ioctl(self.fileno(), termios.TIOCEXCL)

    def fileno(self) -> int:
        """Return the file descriptor, for example to pass it to a guard process."""
        return int(self._serial.fileno())

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``."""
        try:
            if not select.select([self.fileno()], [], [], max(0.0, timeout))[0]:
                return b""
            data = os.read(self.fileno(), _CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._unplugged_error(error) from None
        if not data:
            raise self._unplugged_error("end of file")
        return data

    def write(self, data: bytes) -> None:
        """See ``Transport.write``."""
        while data:
            try:
                if not select.select([], [self.fileno()], [], WRITE_TIMEOUT)[1]:
                    raise LinkError(f"{self.port} accepts no bytes: is the device hung? replug it")
                data = data[os.write(self.fileno(), data) :]
            except BlockingIOError:
                continue
            except (OSError, ValueError) as error:
                raise self._unplugged_error(error) from None

    def set_baud(self, baud: int) -> None:
        """See ``Transport.set_baud``."""
        try:
            self._serial.baudrate = baud
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(f"{self.port} cannot do {baud} baud: {error}") from None

    def set_dtr(self, on: bool) -> None:
        """See ``Transport.set_dtr``."""
        try:
            if on:
                self._keep_modem_lines()
            self._serial.dtr = on
        except OSError as error:
            if error.errno not in (errno.ENOTTY, errno.EINVAL):
                raise self._unplugged_error(error) from None

    def _keep_modem_lines(self) -> None:
        """Tell the system not to clear the modem lines when the port is closed (HUPCL, termios(3)).

        Raises:
            LinkError: The device is unplugged.
        """
        try:
            attributes = termios.tcgetattr(self.fileno())
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(self.fileno(), termios.TCSANOW, attributes)
        except termios.error as error:
            # A socket is no terminal
            if error.args[0] not in (errno.ENOTTY, errno.EINVAL):
                raise self._unplugged_error(error) from None

    def discard_input(self) -> None:
        """See ``Transport.discard_input``."""
        while self.read(0.0):
            pass

    def close(self) -> None:
        """See ``Transport.close``."""
        self._serial.close()

    def _unplugged_error(self, why: object) -> LinkError:
        return LinkError(f"{self.port} was unplugged ({why}): check the cable and the power")


Tap = Callable[[float, Literal["<", ">"], bytes], None]
"""Called with timestamp [s], direction (``<`` from the device, ``>`` to it) and bytes."""


class Tapped:
    """A ``Transport`` that reports all traffic to a tap."""

    def __init__(self, transport: Transport, clock: Clock, tap: Tap) -> None:
        self._transport = transport
        self._clock = clock
        self._tap = tap
        self.set_baud = transport.set_baud
        self.set_dtr = transport.set_dtr
        self.discard_input = transport.discard_input
        self.close = transport.close

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``."""
        data = self._transport.read(timeout)
        if data:
            self._tap(self._clock.now(), "<", data)
        return data

    def write(self, data: bytes) -> None:
        """See ``Transport.write``."""
        self._tap(self._clock.now(), ">", data)
        self._transport.write(data)


class Reopening:
    """A ``Transport`` that reopens its port after it was unplugged.

    Until then nothing arrives, and what is sent is lost.

    Attributes:
        away: Whether the port is unplugged.
    """

    def __init__(
        self,
        open_port: Callable[[], Transport],
        clock: Clock,
        first: bytes,
        on_lost: Callable[[], None] = lambda: None,
    ) -> None:
        """Open the port.

        Args:
            open_port: Opens the port; called repeatedly while it is unplugged.
            clock: Times the attempts to reopen it.
            first: Bytes sent as soon as the port is open again.
            on_lost: Called after the port was lost and closed.

        Raises:
            LinkError: It cannot be opened.
        """
        self.away = False
        self._open_port, self._clock, self._first, self._on_lost = open_port, clock, first, on_lost
        self._port = open_port()
        self._baud: int | None = None
        self._due, self._wait = 0.0, RETRY[0]

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``; does not wait while the port is away."""
        if not self._reopen_if_due():
            return b""
        try:
            return self._port.read(timeout)
        except LinkError as error:
            self._drop_port(error)
            return b""

    def write(self, data: bytes) -> None:
        """See ``Transport.write``; lost while the port is away."""
        if self._reopen_if_due():
            try:
                self._port.write(data)
            except LinkError as error:
                self._drop_port(error)

    def set_baud(self, baud: int) -> None:
        """See ``Transport.set_baud``."""
        self._baud = baud
        if self._reopen_if_due():
            self._port.set_baud(baud)

    def set_dtr(self, on: bool) -> None:
        """See ``Transport.set_dtr``; lost while the port is away."""
        if self._reopen_if_due():
            self._port.set_dtr(on)

    def discard_input(self) -> None:
        """See ``Transport.discard_input``."""
        while self.read(0.0):
            pass

    def close(self) -> None:
        """See ``Transport.close``."""
        self._port.close()

    def _reopen_if_due(self) -> bool:
        """Return whether the port is open; if not, first try to reopen it when that is due."""
        if self.away and self._clock.now() >= self._due:
            with suppress(LinkError):
                self._port = self._open_port()
                if self._baud is not None:
                    self._port.set_baud(self._baud)
                self._port.write(self._first)
                self.away, self._wait = False, RETRY[0]
                log.warning("the port is back")
                return True
            self._wait = min(RETRY[1], 2 * self._wait)
            self._due = self._clock.now() + self._wait
        return not self.away

    def _drop_port(self, error: LinkError) -> None:
        log.warning("%s; trying again", error)
        self.away, self._due = True, self._clock.now() + self._wait
        self._port.close()
        self._on_lost()


def is_away(transport: Transport) -> bool:
    """Return whether ``transport`` is waiting for an unplugged port."""
    return isinstance(transport, Reopening) and transport.away


def holders(port: str) -> list[str]:
    """Return the other processes known to have ``port`` open, for example ``42 (cat)``.

    Processes of other users are known to root only.
    """
    target = os.path.realpath(port)
    if not _may_be_serial(target):
        return []
    found = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            if os.readlink(link) == target and link.parts[2] != str(os.getpid()):
                found.add(f"{link.parts[2]} ({(link.parents[1] / 'comm').read_text().strip()})")
    return sorted(found)


def _may_be_serial(path: str) -> bool:
    """Return whether a device is there, other than those that everybody has open."""
    try:
        found = os.stat(path)
    except OSError:
        return False
    return stat.S_ISCHR(found.st_mode) and os.major(found.st_rdev) != MEMORY_DEVICES


def _options(port: str) -> dict[str, Any]:
    return {} if "://" in port else {"exclusive": True}


def _explain_open_error(port: str, error: Exception) -> str:
    """Return cause and cure in one line."""
    number = getattr(error, "errno", None)

    # Address, path and permission
    if "://" in port:
        return f"cannot connect to {port}: is `twin emulate --tcp` or the bridge running? ({error})"
    if number == errno.ENOENT:
        return f"there is no port {port}: plug the device in; `twin doctor` lists the ports"
    if number == errno.EACCES:
        group = _group(port)
        return (
            f"no permission for {port}: run `sudo usermod -aG {group} $USER` and log in again "
            f"(the port belongs to the group {group})"
        )

    # Port in use, or not a serial port
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error):
        return _name_holders(port, holders(port))
    if "configure port" in str(error) or isinstance(error, termios.error):
        return f"{port} is no serial port: give a device such as /dev/ttyUSB0"
    return f"cannot open {port}: {error}"


def _name_holders(port: str, others: Sequence[str]) -> str:
    return f"{port} is in use by {', '.join(others) or 'another process'}: end it first"


def _group(port: str) -> str:
    try:
        return grp.getgrgid(os.stat(port).st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"
