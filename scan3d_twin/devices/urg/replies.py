"""Replies of SCIP: lines with checksums, in blocks that end with an empty line.

Source: the specification named in ``codec``. Every line is verified by its checksum, except the
echo of the request, which has none: compare it with the request that was sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.codec import (
    ScanRequest,
    checksum,
    decode_values,
    encode_value,
    is_sixbit,
)

BLOCK = 64
"""Characters of data per line; a value may be split across two lines."""
DONE, STREAMED = "00", "99"
"""Status of a completed request, and of a scan in a stream."""
MAX_LINE = 256
"""Length at which a line is cut off [bytes]; a full line of data has 65."""
MAX_LINES = 512
"""Number of lines kept of a block; 769 three-character values fill 37."""

Block = tuple[bytes, ...]
"""The lines of a reply."""


class Splitter:
    """Cuts a stream of bytes, fed in pieces of any size, into blocks.

    Lines may also end with CR LF, as behind a bridge or a terminal that translates line ends.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._lines: list[bytes] = []

    def feed(self, data: bytes) -> list[Block]:
        """Return the non-empty blocks completed by ``data``."""
        blocks = []
        *complete, rest = data.split(b"\n")

        # Complete lines
        for piece in complete:
            line = bytes(self._line + piece).rstrip(b"\r")[:MAX_LINE]
            self._line.clear()
            if line:
                del self._lines[: max(0, len(self._lines) - MAX_LINES + 1)]
                self._lines.append(line)
            elif self._lines:
                blocks.append(tuple(self._lines))
                self._lines = []

        # Start of the next line
        self._line += rest[:MAX_LINE]
        del self._line[MAX_LINE:]
        return blocks

    @property
    def is_empty(self) -> bool:
        """Whether no part of a block has arrived."""
        return not (self._line or self._lines)

    @property
    def lines(self) -> Block:
        """The complete lines of the unfinished block."""
        return tuple(self._lines)

    def reset(self) -> None:
        """Discard what has been fed and not returned."""
        self._line.clear()
        self._lines = []


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply of SCIP 2.0 with a valid status line.

    Attributes:
        echo: The request it answers; no checksum protects it.
        status: Two characters.
        lines: The lines that follow, with their checksums not yet verified.
    """

    echo: str
    status: str
    lines: Block = ()


@dataclass(frozen=True, slots=True)
class Scan:
    """The distances of one turn of the mirror.

    Attributes:
        time_ms: The sensor's timer at step 0, modulo 2**24 [ms].
        values: Distances [mm], or error codes below 20.
    """

    time_ms: int
    values: list[int]


def is_data(line: bytes) -> bool:
    """Return whether ``line`` is a full line of data; noise passes in 1 of 10**40 cases."""
    return len(line) == BLOCK + 1 and is_sixbit(line) and line[-1] == checksum(line[:-1])


def find_echo(block: Block, echo: str) -> Block:
    """Return ``block`` from the last line equal to ``echo`` on; empty if there is none.

    Lines before it are remains of earlier replies or of a boot banner.
    """
    wanted = echo.encode("latin-1")
    for start in range(len(block) - 1, -1, -1):
        if block[start] == wanted:
            return block[start:]
    return ()


def decode_reply(block: Block) -> Reply:
    """Return the reply of SCIP 2.0 in ``block``.

    Raises:
        ProtocolError: There is no status line, or its checksum is wrong.
    """
    if len(block) < 2 or len(block[1]) != 3:
        raise ProtocolError(f"not a reply of SCIP 2.0: {_excerpt(block)}")
    status = strip_checksum(block[1])
    return Reply(block[0].decode("latin-1"), status.decode("ascii"), block[2:])


def encode_reply(echo: str, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a reply of SCIP 2.0; ``lines`` must include their checksums."""
    head = (echo.encode("latin-1"), append_checksum(status.encode("ascii")))
    return b"\n".join((*head, *lines, b"", b""))


def decode_old_reply(block: Block) -> tuple[str, str, Block]:
    """Return echo, status (one character) and further lines of a reply of SCIP 1.1.

    Raises:
        ProtocolError: There is no status line of SCIP 1.1.
    """
    if len(block) < 2 or len(block[1]) != 1:
        raise ProtocolError(f"not a reply of SCIP 1.1: {_excerpt(block)}")
    return block[0].decode("latin-1"), block[1].decode("latin-1"), block[2:]


def encode_old_reply(echo: str, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a reply of SCIP 1.1."""
    return b"\n".join((echo.encode("latin-1"), status.encode("ascii"), *lines, b"", b""))


def encode_text(key: str, value: str) -> bytes:
    """Return a line of VV, PP or II; the checksum does not cover the semicolon."""
    text = f"{key}:{value}".encode("latin-1")
    return text + b";" + bytes([checksum(text)])


def decode_text(line: bytes) -> tuple[str, str]:
    """Return key and value of a line of VV, PP or II.

    Raises:
        ProtocolError: It has another form, or its checksum is wrong.
    """
    text = line[:-2].decode("latin-1")
    key, colon, value = text.partition(":")
    printable = text.isascii() and text.isprintable()
    if not (key and colon and printable) or line[-2:] != b";%c" % checksum(line[:-2]):
        raise ProtocolError(f"bad line {line!r}")
    return key, value


def decode_texts(reply: Reply) -> dict[str, str]:
    """Return the keys and values of VV, PP or II.

    Raises:
        ProtocolError: A line is invalid.
    """
    return dict(decode_text(line) for line in reply.lines)


def salvage_texts(reply: Reply) -> dict[str, str]:
    """Return the keys and values of the valid lines.

    On some URG-04LX every reply to VV has a stray line and a wrong checksum on ``SERI``.
    """
    return dict(_iterate_valid_texts(reply.lines))


def encode_time(time_ms: int) -> bytes:
    """Return the line of the sensor's timer."""
    return append_checksum(encode_value(time_ms, 4))


def decode_time(reply: Reply) -> int:
    """Return the timer in a reply to TM1 [ms], 24 bits.

    Raises:
        ProtocolError: There is no timer, or its checksum is wrong.
    """
    if len(reply.lines) != 1:
        raise ProtocolError(f"{len(reply.lines)} lines instead of a time")
    return decode_timer(reply.lines[0])


def encode_scan(scan: Scan, width: int) -> list[bytes]:
    """Return the lines of a scan with ``width`` characters per value."""
    data = b"".join(encode_value(value, width) for value in scan.values)
    return [encode_time(scan.time_ms), *map(append_checksum, _split_rows(data))]


def decode_scan(reply: Reply, request: ScanRequest) -> Scan:
    """Return the scan in a reply to ``request``.

    Raises:
        ProtocolError: A checksum or the number of values is wrong.
    """
    # Decode the timer
    if not reply.lines:
        raise ProtocolError("no time in the reply")
    time_ms = decode_timer(reply.lines[0])

    # Join the rows of data
    rows = [strip_checksum(line) for line in reply.lines[1:]]
    if any(len(row) != BLOCK for row in rows[:-1]):
        raise ProtocolError(f"a line before the last does not have {BLOCK} characters")

    # Decode the values
    values = decode_values(b"".join(rows), request.width)
    if len(values) != request.n_values:
        raise ProtocolError(f"{len(values)} values instead of {request.n_values}")
    return Scan(time_ms, values)


def encode_old_scan(values: Sequence[int]) -> list[bytes]:
    """Return the lines of a scan in SCIP 1.1: two characters per value, no checksums."""
    return list(_split_rows(b"".join(encode_value(value, 2) for value in values)))


def decode_old_scan(lines: Block) -> list[int]:
    """Return the distances in a reply of SCIP 1.1 to G [mm].

    Raises:
        ProtocolError: The lines are not values of two characters each.
    """
    return decode_values(b"".join(lines), 2)


def scan_length(request: ScanRequest) -> int:
    """Return the size of a scan in reply to ``request``, including all framing [bytes]."""
    data = request.n_values * request.width
    lines = -(-data // BLOCK)
    # Framing: echo; status and time, with checksum; checksum and line feed per line; an empty line
    return len(request.request().echo) + 1 + 4 + 6 + data + 2 * lines + 1


def decode_timer(line: bytes) -> int:
    """Return the timer in the ``line`` of a scan or of a reply to TM1 [ms].

    Raises:
        ProtocolError: It holds none, or its checksum is wrong.
    """
    text = strip_checksum(line)
    if len(text) != 4:
        raise ProtocolError(f"no time: {line!r}")
    return decode_values(text, 4)[0]


def append_checksum(line: bytes) -> bytes:
    """Return ``line`` with its checksum."""
    return line + bytes([checksum(line)])


def strip_checksum(line: bytes) -> bytes:
    """Return ``line`` without its checksum.

    Raises:
        ProtocolError: The checksum is wrong.
    """
    text = line[:-1]
    if len(text) < 1 or not is_sixbit(text) or line[-1] != checksum(text):
        raise ProtocolError(f"wrong checksum in {line!r}")
    return text


def _split_rows(data: bytes) -> Iterator[bytes]:
    return (data[i : i + BLOCK] for i in range(0, len(data), BLOCK))


def _iterate_valid_texts(lines: Block) -> Iterator[tuple[str, str]]:
    for line in lines:
        try:
            yield decode_text(line)
        except ProtocolError:
            continue


def _excerpt(block: Block) -> str:
    return repr(b"\n".join(block)[:40])
