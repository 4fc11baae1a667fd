"""Reads MCAP files, complete or cut off where a run was killed (recovery)."""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk
from zstandard import ZstdError

from scan3d_twin.core.errors import FileError

_MAGIC = b"\x89MCAP0\r\n"
_READ_ERRORS = (McapError, CRCValidationError, ZstdError, struct.error, ValueError, KeyError)
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
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise FileError(f"{path} is no session file")
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(len(_MAGIC), size - len(_MAGIC)))
            return stream.read() == _MAGIC
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


def is_sound(path: Path) -> bool:
    """Return whether every message of the complete file at ``path`` can be read.

    Raises:
        FileError: The file cannot be opened.
    """
    try:
        with path.open("rb") as stream:
            for _ in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                pass
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except _READ_ERRORS:
        return False
    return True


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


def read_contents(path: Path, *topics: str) -> Iterator[RawMessage | Metadata]:
    """Yield metadata and messages, of ``topics`` or of all, in the order of writing.

    An unfinished file is read up to its last complete record.

    Raises:
        FileError: The file cannot be read, is no MCAP file, or is complete but damaged.
    """
    finished = is_finished(path)
    try:
        with path.open("rb") as stream:
            if finished and topics:
                yield from _indexed(stream, topics)
                return
            yield from (each for each in _scanned(stream) if _is_wanted(each, topics))
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except _READ_ERRORS as error:
        raise FileError(
            f"{path} is damaged ({error}); save what is left: twin session recover {path.parent}"
        ) from None


def _is_wanted(each: RawMessage | Metadata, topics: tuple[str, ...]) -> bool:
    return not topics or isinstance(each, Metadata) or each.topic in topics


def _indexed(stream: IO[bytes], topics: tuple[str, ...]) -> Iterator[RawMessage | Metadata]:
    """Yield the content by the index of a complete file."""
    reader = make_reader(stream, validate_crcs=True)
    yield from reader.iter_metadata()
    for schema, channel, message in reader.iter_messages(topics, log_time_order=False):
        assert schema is not None
        yield _delivered(schema, channel, message)


def _scanned(stream: IO[bytes]) -> Iterator[RawMessage | Metadata]:
    """Yield the content from the start up to the first damaged record."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in _sound_records(stream):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata):
            yield record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            yield _delivered(schemas[channel.schema_id], channel, record)


def _delivered(schema: Schema, channel: Channel, message: Message) -> RawMessage:
    latched = "offered_qos_profiles" in channel.metadata
    return RawMessage(channel.topic, schema.name, latched, message.log_time, message.data)


def _sound_records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of complete chunks, and complete metadata records."""
    # Walk over the records
    size = stream.seek(0, os.SEEK_END)
    place = stream.seek(len(_MAGIC))
    while place + 9 <= size:
        opcode, length = struct.unpack("<BQ", stream.read(9))
        place += 9 + length
        if place > size or opcode == Opcode.DATA_END:
            return
        if opcode not in (Opcode.CHUNK, Opcode.METADATA):
            stream.seek(place)
            continue

        # Parse chunks and metadata
        try:
            records = _parsed(opcode, stream.read(length))
        except _READ_ERRORS:
            return
        yield from records


def _parsed(opcode: int, data: bytes) -> list[McapRecord]:
    stream = ReadDataStream(BytesIO(data))
    if opcode == Opcode.METADATA:
        return [Metadata.read(stream)]
    return breakup_chunk(Chunk.read(stream), validate_crc=True)
