"""What a sensor that speaks SCIP answers: lines with sums, and blocks that an empty line ends.

Source: the specification named in ``scip``. Nothing is believed without its sum, except the echo of
the request, which has none: compare it with what was asked.
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
"""Characters of data per line, wherever that cuts a value."""
DONE, STREAMED = "00", "99"
"""Status of a request that was carried out, and of a scan in a stream."""
MAX_LINE = 256
"""Longest line that is kept [bytes]; the longest of the sensor, the state's, has about 60."""
MAX_LINES = 512
"""Most lines of a block that are kept; 769 three-character values fill 37."""

Block = tuple[bytes, ...]
"""The lines of a reply."""


class Splitter:
    """Cuts a stream of bytes, fed in pieces of any size, into blocks."""

    def __init__(self) -> None:
        self._line = bytearray()
        self._lines: list[bytes] = []

    def feed(self, data: bytes) -> list[Block]:
        """Return the blocks that ``data`` completes; empty ones are left out."""
        blocks = []
        *complete, rest = data.split(b"\n")
        for piece in complete:
            line = bytes(self._line + piece)[:MAX_LINE]
            self._line.clear()
            if line:
                del self._lines[: max(0, len(self._lines) - MAX_LINES + 1)]
                self._lines.append(line)
            elif self._lines:
                blocks.append(tuple(self._lines))
                self._lines = []
        self._line += rest[:MAX_LINE]
        del self._line[MAX_LINE:]
        return blocks

    @property
    def is_empty(self) -> bool:
        """Whether no block has begun."""
        return not (self._line or self._lines)

    @property
    def lines(self) -> Block:
        """The whole lines of the block that is not complete yet."""
        return tuple(self._lines)

    def reset(self) -> None:
        """Forget what has been fed and not returned."""
        self._line.clear()
        self._lines = []


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply of SCIP 2.0 whose status line is whole.

    Attributes:
        echo: The request it answers; no sum protects it.
        status: Two characters.
        lines: What follows, with sums not yet checked.
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
    """Return whether ``line`` is a full line of data; garbage is one in 10**40 cases."""
    return len(line) == BLOCK + 1 and is_sixbit(line) and line[-1] == checksum(line[:-1])


def find_echo(block: Block, echo: str) -> Block:
    """Return ``block`` from the last line that is ``echo`` on; empty if there is none.

    A line before it is what the wire left of earlier replies or of a boot banner.
    """
    wanted = echo.encode("latin-1")
    for start in range(len(block) - 1, -1, -1):
        if block[start] == wanted:
            return block[start:]
    return ()


def decode_reply(block: Block) -> Reply:
    """Return the reply of SCIP 2.0 in ``block``.

    Raises:
        ProtocolError: There is no status line, or its sum is wrong.
    """
    if len(block) < 2 or len(block[1]) != 3:
        raise ProtocolError(f"no reply of SCIP 2.0: {_shown(block)}")
    status = _without_sum(block[1])
    return Reply(block[0].decode("latin-1"), status.decode("ascii"), block[2:])


def encode_reply(echo: str, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a reply of SCIP 2.0; ``lines`` come with their sums."""
    head = (echo.encode("latin-1"), _with_sum(status.encode("ascii")))
    return b"\n".join((*head, *lines, b"", b""))


def decode_old_reply(block: Block) -> tuple[str, str, Block]:
    """Return echo, status (one character) and further lines of a reply of SCIP 1.1.

    Raises:
        ProtocolError: There is no such status line.
    """
    if len(block) < 2 or len(block[1]) != 1:
        raise ProtocolError(f"no reply of SCIP 1.1: {_shown(block)}")
    return block[0].decode("latin-1"), block[1].decode("latin-1"), block[2:]


def encode_old_reply(echo: str, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a reply of SCIP 1.1."""
    return b"\n".join((echo.encode("latin-1"), status.encode("ascii"), *lines, b"", b""))


def encode_text(key: str, value: str) -> bytes:
    """Return a line of VV, PP or II; the semicolon is not part of the sum."""
    text = f"{key}:{value}".encode("latin-1")
    return text + b";" + bytes([checksum(text)])


def decode_text(line: bytes) -> tuple[str, str]:
    """Return key and value of a line of VV, PP or II.

    Raises:
        ProtocolError: The sum is wrong, or it is no such line.
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
        ProtocolError: A line is bad.
    """
    return dict(decode_text(line) for line in reply.lines)


def salvage_texts(reply: Reply) -> dict[str, str]:
    """Return the keys and values of the good lines.

    VV of some URG-04LX has a stray line and a wrong sum on ``SERI`` every time.
    """
    return dict(_good_texts(reply.lines))


def encode_time(time_ms: int) -> bytes:
    """Return the line of the sensor's timer."""
    return _with_sum(encode_value(time_ms, 4))


def decode_time(reply: Reply) -> int:
    """Return the timer in a reply to TM1 [ms], 24 bits.

    Raises:
        ProtocolError: There is none, or its sum is wrong.
    """
    if len(reply.lines) != 1:
        raise ProtocolError(f"{len(reply.lines)} lines instead of a time")
    return _time(reply.lines[0])


def encode_scan(scan: Scan, width: int) -> list[bytes]:
    """Return the lines of a scan with ``width`` characters a value."""
    data = b"".join(encode_value(value, width) for value in scan.values)
    return [encode_time(scan.time_ms), *map(_with_sum, _cut(data))]


def decode_scan(reply: Reply, request: ScanRequest) -> Scan:
    """Return the scan in a reply to ``request``.

    Raises:
        ProtocolError: A sum is wrong, or there are more or fewer values than asked for.
    """
    if not reply.lines:
        raise ProtocolError("no time in the reply")
    time_ms = _time(reply.lines[0])
    rows = [_without_sum(line) for line in reply.lines[1:]]
    if any(len(row) != BLOCK for row in rows[:-1]):
        raise ProtocolError(f"a line before the last has not {BLOCK} characters")
    values = decode_values(b"".join(rows), request.width)
    if len(values) != request.n_values:
        raise ProtocolError(f"{len(values)} values instead of {request.n_values}")
    return Scan(time_ms, values)


def encode_old_scan(values: Sequence[int]) -> list[bytes]:
    """Return the lines of a scan in SCIP 1.1: two characters a value and no sums."""
    return list(_cut(b"".join(encode_value(value, 2) for value in values)))


def decode_old_scan(lines: Block) -> list[int]:
    """Return the distances in a reply of SCIP 1.1 to G [mm].

    Raises:
        ProtocolError: They are no values of two characters each.
    """
    return decode_values(b"".join(lines), 2)


def scan_length(request: ScanRequest) -> int:
    """Return the bytes of a scan in reply to ``request``, with all that is around it."""
    data = request.n_values * request.width
    lines = -(-data // BLOCK)
    # Echo, status with sum and time with sum, a line feed each; sum and feed a line; an empty line.
    return len(request.request().echo) + 1 + 4 + 6 + data + 2 * lines + 1


def _time(line: bytes) -> int:
    text = _without_sum(line)
    if len(text) != 4:
        raise ProtocolError(f"no time: {line!r}")
    return decode_values(text, 4)[0]


def _with_sum(line: bytes) -> bytes:
    return line + bytes([checksum(line)])


def _without_sum(line: bytes) -> bytes:
    """Return ``line`` without its sum, which is right."""
    text = line[:-1]
    if len(text) < 1 or not is_sixbit(text) or line[-1] != checksum(text):
        raise ProtocolError(f"wrong sum in {line!r}")
    return text


def _cut(data: bytes) -> Iterator[bytes]:
    return (data[i : i + BLOCK] for i in range(0, len(data), BLOCK))


def _good_texts(lines: Block) -> Iterator[tuple[str, str]]:
    for line in lines:
        try:
            yield decode_text(line)
        except ProtocolError:
            continue


def _shown(block: Block) -> str:
    return repr(b"\n".join(block)[:40])
