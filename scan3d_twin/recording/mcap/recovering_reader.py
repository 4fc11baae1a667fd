"""Reads MCAP files, complete or cut off where a run was killed (recovery)."""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap.chunks import (
    ChunkError,
    Expansion,
    LimitError,
    StoredMessage,
    expand,
    parse_chunk,
    record_at,
    records_of,
)

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<QQI")
"""Body of the footer: start of the summary, of its offsets, and the checksum of the summary."""
READ_ERRORS = (McapError, struct.error, ValueError, KeyError)
"""Errors of a reader where a part of the file is lost."""


@dataclass(frozen=True, slots=True)
class RawMessage:
    """An encoded message in a file.

    Attributes:
        topic: Its topic.
        name: Its type.
        latched: Whether late subscribers need it too.
        nanoseconds: Its stamp on the robot's clock [ns].
        data: The message as CDR.
    """

    topic: str
    name: str
    latched: bool
    nanoseconds: int
    data: bytes


def is_finished(path: Path) -> bool:
    """Return whether the file at ``path`` is complete, by its last bytes.

    Raises:
        FileError: The file cannot be read, or is no MCAP file.
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise FileError(f"{path} is no session file")
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(len(MAGIC), size - len(MAGIC)))
            return stream.read() == MAGIC
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


def is_sound(path: Path) -> bool:
    """Return whether the complete file at ``path`` is right: every record, index and checksum.

    Raises:
        FileError: The file cannot be opened.
    """
    try:
        with map_file(path) as data:
            for _ in _scanned(data, Expansion.of_file(len(data)), complete=True):
                pass
            return _is_indexed(data)
    except READ_ERRORS:
        return False


def _is_indexed(data: bytes) -> bool:
    """Return whether the index of the whole file ``data`` names the chunks that are there."""
    # Check the summary against its checksum
    footer = len(data) - len(MAGIC) - _FOOTER.size
    start, _, crc = _FOOTER.unpack_from(data, footer)
    if crc and zlib.crc32(data[start : footer + _FOOTER.size - 4]) != crc:
        return False

    # Compare the index with the chunks
    found = []
    for place in _places(data, complete=True):
        record = record_at(data, place)
        assert record is not None
        if record.opcode == Opcode.CHUNK:
            chunk = parse_chunk(data[record.body : record.end])
            found.append((place, *chunk.times, chunk.size))
    stated = [
        (each.chunk_start_offset, each.message_start_time, each.message_end_time,
         each.uncompressed_size)
        for each in read_summary(data).chunk_indexes
    ]  # fmt: skip
    return found == stated


def is_written(path: Path) -> bool:
    """Return whether a running program is writing to the file at ``path``."""
    try:
        with path.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@contextmanager
def map_file(path: Path) -> Iterator[bytes]:
    """Map the file at ``path`` into memory, as bytes that are read when they are needed.

    Raises:
        FileError: The file cannot be read, or is no MCAP file.
    """
    is_finished(path)
    try:
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, prot=mmap.PROT_READ) as data:
            yield data  # type: ignore[misc]  # slices of it are bytes
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


def read_contents(path: Path, *topics: str) -> Iterator[RawMessage | Metadata]:
    """Yield metadata and messages, of ``topics`` or of all, in the order of writing.

    An unfinished file is read up to its last complete record.

    Raises:
        FileError: The file cannot be read, is no MCAP file, is complete but damaged, or expands to
            far more than its size.
    """
    finished = is_finished(path)
    try:
        with map_file(path) as data:
            expansion = Expansion.of_file(len(data))
            if finished and topics:
                yield from _indexed(data, expansion, topics)
                return
            scanned = _scanned(data, expansion, complete=finished)
            yield from (each for each in scanned if _is_wanted(each, topics))
    except LimitError as error:
        raise FileError(f"{path} {error}") from None
    except READ_ERRORS as error:
        reason = str(error) or type(error).__name__
        raise FileError(
            f"{path} is damaged ({reason}); save what is left: twin session recover {path.parent}"
        ) from None


def _is_wanted(each: RawMessage | Metadata, topics: tuple[str, ...]) -> bool:
    return not topics or isinstance(each, Metadata) or each.topic in topics


def read_summary(data: bytes) -> Summary:
    """Return the summary of the complete file ``data``.

    Raises:
        ChunkError: There is none.
    """
    # Find the footer
    footer = len(data) - len(MAGIC) - _FOOTER.size - 9
    record = record_at(data, footer)
    if record is None or record.opcode != Opcode.FOOTER:
        raise ChunkError("no footer")
    start, *_ = _FOOTER.unpack_from(data, record.body)
    if not len(MAGIC) <= start < footer:
        raise ChunkError("no index")

    # Collect its records; chunks, which a false start may lead to, stay packed
    summary = Summary()
    for each in StreamReader(BytesIO(data[start:]), skip_magic=True, emit_chunks=True).records:
        if isinstance(each, Schema):
            summary.schemas[each.id] = each
        elif isinstance(each, Channel):
            summary.channels[each.id] = each
        elif isinstance(each, ChunkIndex):
            summary.chunk_indexes.append(each)
        elif isinstance(each, MetadataIndex):
            summary.metadata_indexes.append(each)
        elif isinstance(each, Statistics):
            summary.statistics = each
    return summary


def _indexed(
    data: bytes, expansion: Expansion, topics: tuple[str, ...]
) -> Iterator[RawMessage | Metadata]:
    """Yield the content by the index of a complete file."""
    # Read the metadata
    summary = read_summary(data)
    for described in summary.metadata_indexes:
        yield read_metadata(data, described.offset)

    # Select chunks with these topics
    channels = Channels(summary.schemas, summary.channels)
    wanted = {number for number, each in summary.channels.items() if each.topic in topics}
    for index in summary.chunk_indexes:
        if index.message_index_offsets and wanted.isdisjoint(index.message_index_offsets):
            continue

        # Yield their messages
        for record in chunk_records(data, index.chunk_start_offset, expansion):
            if isinstance(record, StoredMessage) and record.channel in wanted:
                yield channels.deliver(record)


def _scanned(
    data: bytes, expansion: Expansion, *, complete: bool
) -> Iterator[RawMessage | Metadata]:
    """Yield the content from the start: of a ``complete`` file all, else up to a damaged record."""
    channels = Channels({}, {})
    for place in _places(data, complete=complete):
        # Read metadata or a chunk
        if data[place] == Opcode.METADATA:
            yield read_metadata(data, place)
            continue
        try:
            records = chunk_records(data, place, expansion)
        except ChunkError:
            if complete:
                raise
            return

        # Yield its messages
        for record in records:
            if isinstance(record, StoredMessage):
                yield channels.deliver(record)
            else:
                channels.declare(record)


def _places(data: bytes, *, complete: bool) -> Iterator[int]:
    """Yield where chunks and metadata records begin.

    Raises:
        ChunkError: A ``complete`` file breaks off before the end of its data.
    """
    place = len(MAGIC)
    while (record := record_at(data, place)) is not None:
        if record.opcode == Opcode.DATA_END:
            return
        if record.opcode in (Opcode.CHUNK, Opcode.METADATA):
            yield place
        place = record.end
    if complete:
        raise ChunkError("the data break off")


@dataclass(frozen=True)
class Channels:
    """The declared schemas and channels by number."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]

    def __contains__(self, number: int) -> bool:
        """Return whether the channel ``number`` and its schema are declared."""
        return number in self.channels and self.channels[number].schema_id in self.schemas

    def declare(self, record: Schema | Channel) -> None:
        """Add a schema or channel."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        else:
            self.channels[record.id] = record

    def deliver(self, stored: StoredMessage) -> RawMessage:
        """Return the message with topic and type.

        Raises:
            KeyError: Its channel or schema is not declared.
        """
        channel = self.channels[stored.channel]
        name = self.schemas[channel.schema_id].name
        latched = "offered_qos_profiles" in channel.metadata
        return RawMessage(channel.topic, name, latched, stored.time, stored.data)


def chunk_records(
    data: bytes, place: int, expansion: Expansion
) -> list[Schema | Channel | StoredMessage]:
    """Return the records of the chunk that begins at ``place`` of ``data``.

    Raises:
        ChunkError: There is no sound chunk.
        LimitError: It is too large.
    """
    record = record_at(data, place)
    if record is None or record.opcode != Opcode.CHUNK:
        raise ChunkError(f"no chunk at byte {place}")
    content = expand(parse_chunk(data[record.body : record.end]), expansion)
    return records_of(content, expansion)


def read_metadata(data: bytes, place: int) -> Metadata:
    """Return the metadata record that begins at ``place`` of ``data``.

    Raises:
        ChunkError: There is no such record.
    """
    record = record_at(data, place)
    if record is None or record.opcode != Opcode.METADATA:
        raise ChunkError(f"no metadata at byte {place}")
    try:
        found: Metadata = Metadata.read(ReadDataStream(BytesIO(data[record.body : record.end])))
    except (struct.error, UnicodeDecodeError, McapError) as error:
        raise ChunkError(f"damaged metadata: {error}") from None
    return found
