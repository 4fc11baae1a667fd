"""SCIP, the protocol of Hokuyo's scanners: numbers, checksums and requests; no I/O.

Sources: "URG Series Communication Protocol Specification SCIP-Version 2.0" (C-42-03320B), called
"the specification" below. SCIP 1.1 follows its section on switching the protocol and the client
programs of that time. Requests are encoded and parsed here, replies in ``replies``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scan3d_twin.core.errors import ProtocolError

BAUDS = (19200, 38400, 57600, 115200, 250000, 500000, 750000)
"""Bit rates accepted by ``SS`` [bit/s]; some firmware does not know 38400."""
OFFSET = 0x30
"""Added to each group of 6 bits so that all characters are printable."""
TIMER_BITS = 24
"""Width of the sensor's timer [ms], which wraps every 4.66 hours."""
TAG_CHARACTERS = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789 ._+@")
"""Characters allowed in a tag."""
MAX_TAG = 16
"""Longest tag [characters]."""
SWITCH = "SCIP2.0"
"""Switches a sensor from SCIP 1.1 to SCIP 2.0."""

_SIXBIT = bytes(range(OFFSET, OFFSET + 64))
_PARAMETERS = {
    **dict.fromkeys(("VV", "PP", "II", "BM", "QT", "RS"), 0),
    **{"TM": 1, "SS": 6, "CR": 2, "HS": 1, "DB": 2, "GD": 10, "GS": 10, "MD": 13, "MS": 13},
}
COMMANDS = tuple(_PARAMETERS)
"""The commands of SCIP 2.0 that an URG-04LX knows."""

ScanCommand = Literal["GD", "GS", "MD", "MS"]


class RequestError(ProtocolError):
    """A request the sensor refuses.

    Attributes:
        status: Status that the sensor answers, two characters.
    """

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message)
        self.status = status


def checksum(data: bytes) -> int:
    """Return the checksum of ``data``: the low 6 bits of the sum of its bytes, plus 0x30."""
    return (sum(data) & 0x3F) + OFFSET


def is_sixbit(data: bytes) -> bool:
    """Return whether all characters of ``data`` encode 6 bits each.

    The checksum misses errors in bits 6 and 7; flipping one of them leaves this range.
    """
    return not data.translate(None, _SIXBIT)


def encode_value(value: int, width: int) -> bytes:
    """Return ``value`` as ``width`` characters, the most significant first.

    Raises:
        ProtocolError: It does not fit into ``width`` characters.
    """
    if not 0 <= value < 1 << 6 * width:
        raise ProtocolError(f"{value} does not fit into {width} characters of 6 bits")
    return bytes((value >> shift & 0x3F) + OFFSET for shift in range(6 * (width - 1), -1, -6))


def decode_values(data: bytes, width: int) -> list[int]:
    """Return the values in ``data``, ``width`` characters each.

    Raises:
        ProtocolError: A character is outside the encoding, or the last value is incomplete.
    """
    if len(data) % width or not is_sixbit(data):
        raise ProtocolError(f"{len(data)} characters are no values of {width} characters each")
    values = [0] * (len(data) // width)
    for column in range(width):
        pairs = zip(values, data[column::width], strict=True)
        values = [value << 6 | character - OFFSET for value, character in pairs]
    return values


@dataclass(frozen=True, slots=True)
class Request:
    """A request of SCIP 2.0.

    Attributes:
        command: Two letters.
        parameters: The characters after them.
        tag: Free text after a semicolon; the sensor echoes it.
    """

    command: str
    parameters: str = ""
    tag: str = ""

    @property
    def echo(self) -> str:
        """The first line of the reply."""
        return self.command + self.parameters + (f";{self.tag}" if self.tag else "")

    def encode(self) -> bytes:
        """Return the bytes to send."""
        return self.echo.encode("ascii") + b"\n"


def parse_request(line: bytes) -> Request:
    """Return the request in a ``line`` without its terminator, parsed as the sensor does.

    Raises:
        RequestError: It is invalid; ``status`` is the sensor's answer.
    """
    # Check the tag
    text, semicolon, tag = line.decode("latin-1").partition(";")
    if len(tag) > MAX_TAG:
        raise RequestError("0G", f"the text after the semicolon has more than {MAX_TAG} characters")
    if semicolon and not TAG_CHARACTERS.issuperset(tag):
        raise RequestError("0H", f"character not allowed in the text {tag!r}")

    # Check command and parameters
    command, parameters = text[:2], text[2:]
    if len(command) < 2:
        raise RequestError("0D", f"no command: {text!r}")
    if command not in _PARAMETERS:
        raise RequestError("0E", f"unknown command {command!r}")
    if len(parameters) < _PARAMETERS[command]:
        raise RequestError("0C", f"too few parameters in {text!r}")
    if len(parameters) > _PARAMETERS[command]:
        raise RequestError("0F", f"too many parameters in {text!r}")
    return Request(command, parameters, tag)


@dataclass(frozen=True, slots=True)
class ScanRequest:
    """A request for distances: GD and GS for the latest scan, MD and MS for a stream of them.

    Attributes:
        command: With a last letter D, three characters per step; with S, two.
        first: First step.
        last: Last step, inclusive.
        cluster: Steps merged into one value, their smallest valid distance; 0 means 1.
        skip: Turns of the mirror left out after each scan of a stream.
        count: Scans in a stream; 0 means without end.
        tag: Free text, see ``Request``.
    """

    command: ScanCommand
    first: int
    last: int
    cluster: int = 1
    skip: int = 0
    count: int = 0
    tag: str = ""

    @property
    def width(self) -> int:
        """Characters per value."""
        return 3 if self.command.endswith("D") else 2

    @property
    def is_stream(self) -> bool:
        """Whether scans are streamed until ``count`` is reached or the stream is stopped."""
        return self.command.startswith("M")

    @property
    def n_values(self) -> int:
        """Values in a scan; the last cluster may hold fewer steps than the others."""
        return -(-(self.last - self.first + 1) // max(1, self.cluster))

    def request(self, remaining: int | None = None) -> Request:
        """Return the request to send; in the echo of a scan, ``remaining`` replaces ``count``."""
        parameters = f"{self.first:04d}{self.last:04d}{self.cluster:02d}"
        if self.is_stream:
            count = self.count if remaining is None else remaining
            parameters += f"{self.skip:d}{count:02d}"
        return Request(self.command, parameters, self.tag)


_FIELDS = (("first", 0, 4), ("last", 4, 8), ("cluster", 8, 10), ("skip", 10, 11), ("count", 11, 13))
# Status by field that is not a number: 01 to 03 for GD, and also 06 and 07 for MD.
_NOT_NUMERIC = {"first": "01", "last": "02", "cluster": "03", "skip": "06", "count": "07"}


def parse_scan_request(request: Request, last_step: int) -> ScanRequest:
    """Return the fields of a ``request`` whose command is GD, GS, MD or MS.

    Args:
        request: From ``parse_request``.
        last_step: Last step of the sensor [AMAX].

    Raises:
        RequestError: A field is not a number (status 01 to 03, 06, 07), ``last`` is beyond the
            last step of the sensor (04) or before ``first`` (05).
    """
    # Parse the numbers
    numbers = {}
    for name, start, stop in _FIELDS[: 5 if request.command.startswith("M") else 3]:
        digits = request.parameters[start:stop]
        if not (digits.isascii() and digits.isdecimal()):
            raise RequestError(_NOT_NUMERIC[name], f"{name} is not a number: {digits!r}")
        numbers[name] = int(digits)

    # Check the steps
    command: ScanCommand = request.command  # type: ignore[assignment]
    scan = ScanRequest(command, tag=request.tag, **numbers)
    if scan.last > last_step:
        raise RequestError("04", f"step {scan.last} is beyond the last step {last_step}")
    if scan.last < scan.first:
        raise RequestError("05", f"last step {scan.last} is before the first step {scan.first}")
    return scan


@dataclass(frozen=True, slots=True)
class OldScanRequest:
    """A request of SCIP 1.1 for the latest scan, two characters per value: ``Gsssssscc``."""

    first: int
    last: int
    cluster: int = 1

    @property
    def echo(self) -> str:
        """The first line of the reply."""
        return f"G{self.first:03d}{self.last:03d}{self.cluster:02d}"


def parse_old_scan_request(line: bytes, last_step: int) -> OldScanRequest:
    """Return the G request of SCIP 1.1 in ``line``.

    Raises:
        RequestError: It is not a G request; SCIP 1.1 answers ``E``.
    """
    digits = line[1:].decode("latin-1")
    if line[:1] == b"G" and len(digits) == 8 and digits.isascii() and digits.isdecimal():
        first, last, cluster = int(digits[:3]), int(digits[3:6]), int(digits[6:])
        if first <= last <= last_step:
            return OldScanRequest(first, last, cluster)
    raise RequestError("E", f"not a request for a scan: {line!r}")
