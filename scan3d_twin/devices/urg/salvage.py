"""Salvage of scans that arrive garbled: every row of their data has a checksum of its own.

Rows are told apart by their place in the reply, so a scan whose length differs too much from that
asked for is refused: rows could be taken for their neighbours. A reply of that length is a scan
even if its head is garbled: the sensor sends nothing else that long.

A checksum of 6 bits misses errors that cancel: two flipped bits, or a byte lost and another one
inserted. The latter shifts what lies between, and nearly every shifted value is out of range; in a
garbled scan a value out of range therefore costs its rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import accumulate, pairwise

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.codec import ScanRequest, decode_values, encode_value, is_sixbit
from scan3d_twin.devices.urg.replies import (
    BLOCK,
    STREAMED,
    Block,
    append_checksum,
    decode_timer,
    strip_checksum,
)

MAX_SLIP = 16
"""Bytes by which a garbled scan may be longer or shorter than a whole one: a quarter of a row, so
that each row is nearest to its own place; four times the standard deviation where 1 byte of 1000 is
lost and as many are inserted."""
HEAD = 3
"""Lines before the data: echo, status and time."""
LOST = -1
"""A value that was lost."""

_HOLE = "\0"
_STATUS_LINE = append_checksum(STREAMED.encode("ascii"))


@dataclass(frozen=True, slots=True)
class GarbledScan:
    """What is left of a scan.

    Attributes:
        time_ms: The sensor's timer at step 0 [ms]; None if it was garbled.
        values: Distances [mm], error codes below 20, or ``LOST``.
        lost_rows: Number of rows that were garbled or out of range.
    """

    time_ms: int | None
    values: list[int]
    lost_rows: int


def split_scans(block: Block, echo: str) -> Iterator[Block]:
    """Yield the replies in ``block``: where an empty line was garbled it holds several.

    A reply begins with the echo, or a line before the status of a scan.
    """
    wanted, part = echo.encode("latin-1"), []
    for line, after in pairwise((*block, b"")):
        if line.endswith(wanted):
            part += [line[: -len(wanted)]] if line != wanted else []
            line = wanted
        elif after != _STATUS_LINE or not part:
            part.append(line)
            continue
        if part:
            yield tuple(part)
        part = [line]
    if part:
        yield tuple(part)


def salvage_scan(block: Block, request: ScanRequest, max_value: int) -> GarbledScan:
    """Return what arrived whole of the reply to ``request`` in ``block``.

    Args:
        block: A reply in which bytes were altered, lost or inserted.
        request: The running stream.
        max_value: Largest value that the sensor sends [mm].

    Raises:
        ProtocolError: It is no scan, or nothing of its data can be told.
    """
    # Recognise it by echo, status or time
    echo = request.request().echo.encode("latin-1")
    head = block[: HEAD + 1]
    time_ms = _find_time(head)
    if echo not in head and _STATUS_LINE not in head and time_ms is None:
        raise ProtocolError(f"no scan: {b' '.join(head)[:40]!r}")

    # Keep the rows that arrived whole, at their places
    sizes = _row_sizes(request)
    rows = _find_rows(block, sizes, len(echo) + 1)
    if not rows:
        raise ProtocolError("no row of the scan arrived whole")

    # Decode the values, and drop rows with values out of range
    values = _decode_rows(rows, sizes, request.width)
    beyond = [i for i, value in enumerate(values) if value > max_value]
    for i in beyond:
        for j in (i * request.width // BLOCK, ((i + 1) * request.width - 1) // BLOCK):
            rows.pop(j, None)
    if beyond:
        values = _decode_rows(rows, sizes, request.width)
    return GarbledScan(time_ms, values, len(sizes) - len(rows))


def _row_sizes(request: ScanRequest) -> list[int]:
    """Return the number of characters of each row of a scan."""
    whole, rest = divmod(request.n_values * request.width, BLOCK)
    return [BLOCK] * whole + [rest] * (rest > 0)


def _find_time(head: Block) -> int | None:
    """Return the timer in the first lines of a reply [ms]; None if it was garbled."""
    for line in head:
        with suppress(ProtocolError):
            return decode_timer(line)
    return None


def _find_rows(block: Block, sizes: list[int], echo_size: int) -> dict[int, bytes]:
    """Return the rows that arrived whole, by their number.

    Raises:
        ProtocolError: The block is too long or too short.
    """
    # Compare the length with that of a whole scan
    starts = list(accumulate((len(line) + 1 for line in block), initial=0))
    first = echo_size + 4 + 6
    slip = starts[-1] - first - sum(size + 2 for size in sizes)
    if abs(slip) > MAX_SLIP:
        raise ProtocolError(f"a scan with {slip:+d} bytes")

    # Assign each whole line to the row whose place is nearest
    rows = {}
    for start, line in zip(starts, block, strict=False):
        number = round((start - first - slip / 2) / (BLOCK + 2))
        if 0 <= number < len(sizes) and len(line) == sizes[number] + 1:
            with suppress(ProtocolError):
                rows[number] = strip_checksum(line)
    return rows


def _decode_rows(rows: dict[int, bytes], sizes: list[int], width: int) -> list[int]:
    """Return the values in ``rows``; ``LOST`` where a character of a value is missing."""
    data = b"".join(rows.get(k, _HOLE.encode() * size) for k, size in enumerate(sizes))
    zero = encode_value(0, 1)
    values = decode_values(data.replace(_HOLE.encode(), zero), width)
    for k in range(0, len(data), width):
        if not is_sixbit(data[k : k + width]):
            values[k // width] = LOST
    return values
