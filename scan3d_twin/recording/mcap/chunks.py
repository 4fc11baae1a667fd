"""Chunks of MCAP files, opened within limits: a small file must not fill the memory.

The reader of the package ``mcap`` believes the sizes that a file states. Session files come from
other people too, so the sizes are checked here before anything is decompressed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from scan3d_twin.limits import expansion_limit, how_to_raise, scaled

MAX_CHUNK = 128 * 1024 * 1024
"""Largest decompressed chunk [bytes]: the recorder ends a chunk with the message that exceeds 256
kB, and a sweep of two million readings is a message of this size."""
MAX_RECORDS = 1_000_000
"""Most records of a chunk: one of 256 kB holds 8,500 of the shortest messages."""
CHUNK_COST, RECORD_COST = 16 * 1024, 256
"""Bytes that a chunk and a record count besides their content, because reading them takes time: so
a small file ends at 4,000 empty chunks or 250,000 empty records, each of a fraction of a second. A
message takes 16 bytes of index in the file alone, which allow it 512."""

_RECORD = struct.Struct("<BQ")
"""Opcode and length of a record's body."""
_CHUNK = struct.Struct("<QQQII")
"""First and last time, size, checksum, and length of the name of the compression."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time."""


class ChunkError(ValueError):
    """A chunk is damaged."""


class LimitError(ValueError):
    """A file expands to more than it may."""


class Record(NamedTuple):
    """A record of a file: its opcode, and where its body begins and ends."""

    opcode: int
    body: int
    end: int


class StoredMessage(NamedTuple):
    """A message of a chunk: number of its channel, log time [ns] and content."""

    channel: int
    time: int
    data: bytes


@dataclass
class Expansion:
    """The number of bytes that a file may still expand to."""

    left: int

    @classmethod
    def of_file(cls, size: int) -> Expansion:
        """Return what a file of ``size`` bytes may expand to."""
        return cls(expansion_limit(size))

    def spend(self, size: int) -> None:
        """Count ``size`` more bytes.

        Raises:
            LimitError: The file expands to more than it may.
        """
        self.left -= size
        if self.left < 0 or size > scaled(MAX_CHUNK):
            raise LimitError(f"expands to far more than its size; {how_to_raise()}")


@dataclass(frozen=True)
class PackedChunk:
    """A chunk as it lies in the file.

    Attributes:
        times: First and last log time of its messages [ns].
        size: Size of its content [bytes].
        crc: Checksum of its content; 0 for none.
        compression: Name of the compression.
        packed: The compressed content.
    """

    times: tuple[int, int]
    size: int
    crc: int
    compression: str
    packed: bytes


def record_at(data: bytes, place: int) -> Record | None:
    """Return the record that begins at ``place`` of ``data``; None if none or not all is there.

    Opcode 0 is none: so look the zeros that a power cut leaves.
    """
    if place < 0 or place + _RECORD.size > len(data):
        return None
    opcode, length = _RECORD.unpack_from(data, place)
    body = place + _RECORD.size
    complete = opcode and body + length <= len(data)
    return Record(opcode, body, body + length) if complete else None


def parse_chunk(body: bytes) -> PackedChunk:
    """Return the chunk with this ``body``.

    Raises:
        ChunkError: Its head is damaged.
    """
    try:
        first, last, size, crc, name_length = _CHUNK.unpack_from(body)
        place = _CHUNK.size + name_length
        name = bytes(body[_CHUNK.size : place]).decode("ascii")
        (length,) = struct.unpack_from("<Q", body, place)
    except (struct.error, UnicodeDecodeError) as error:
        raise ChunkError(f"a chunk without a head: {error}") from None
    if place + 8 + length > len(body):
        raise ChunkError("a chunk that is not complete")
    packed = bytes(body[place + 8 : place + 8 + length])
    return PackedChunk((first, last), size, crc, name, packed)


def expand(chunk: PackedChunk, expansion: Expansion) -> bytes:
    """Return the content of ``chunk``, checked.

    Raises:
        ChunkError: It is damaged, or compressed in an unknown way.
        LimitError: It is too large.
    """
    expansion.spend(chunk.size)
    expansion.spend(CHUNK_COST)
    content = _decompress(chunk)
    if len(content) != chunk.size:
        raise ChunkError(f"a chunk of {len(content)} instead of {chunk.size} bytes")
    if chunk.crc and zlib.crc32(content) != chunk.crc:
        raise ChunkError("a chunk with a wrong checksum")
    return content


def _decompress(chunk: PackedChunk) -> bytes:
    packed = chunk.packed
    try:
        if chunk.compression == "":
            return packed
        if chunk.compression == "zstd":
            stated = zstandard.frame_content_size(packed)
            if stated not in (-1, chunk.size):
                raise ChunkError("a chunk that states two sizes")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=chunk.size)
        if chunk.compression == "lz4":  # not ours, but that of tools which rewrite files
            import lz4.frame  # type: ignore[import-untyped]

            decompressor = lz4.frame.LZ4FrameDecompressor()
            return bytes(decompressor.decompress(packed, max_length=chunk.size))
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ChunkError(f"a chunk that cannot be decompressed: {error}") from None
    raise ChunkError(f"a chunk with unknown compression {chunk.compression!r}")


def records_of(content: bytes, expansion: Expansion) -> list[Schema | Channel | StoredMessage]:
    """Return the schemas, channels and messages in the ``content`` of a chunk.

    Each record counts for the ``expansion`` of its file.

    Raises:
        ChunkError: It is damaged.
        LimitError: It holds too many records.
    """
    try:
        return list(_parse_records(content, expansion))
    except (struct.error, UnicodeDecodeError, McapError) as error:
        raise ChunkError(f"a chunk with a damaged record: {error}") from None


def _parse_records(
    content: bytes, expansion: Expansion
) -> Iterator[Schema | Channel | StoredMessage]:
    place, count = 0, 0
    while place < len(content):
        # Find the record
        record, count = record_at(content, place), count + 1
        if record is None:
            raise ChunkError("a chunk that ends within a record")
        if count > scaled(MAX_RECORDS):
            raise LimitError(f"holds too many records in a chunk; {how_to_raise()}")
        expansion.spend(RECORD_COST)
        place = record.end

        # Parse it
        if record.opcode == Opcode.MESSAGE:
            if record.body + _MESSAGE.size > record.end:
                raise ChunkError("a message without a head")
            channel, _, time, _ = _MESSAGE.unpack_from(content, record.body)
            yield StoredMessage(channel, time, content[record.body + _MESSAGE.size : record.end])
        elif record.opcode == Opcode.SCHEMA:
            yield Schema.read(ReadDataStream(BytesIO(content[record.body : record.end])))
        elif record.opcode == Opcode.CHANNEL:
            yield Channel.read(ReadDataStream(BytesIO(content[record.body : record.end])))
