"""What is left of a damaged MCAP file: every sound chunk, wherever it lies.

Neither index nor record lengths are trusted. A chunk is found by the index, by walking over the
records, or by its own mark, and counts if its checksum is right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Metadata

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap.chunks import (
    Expansion,
    LimitError,
    StoredMessage,
    parse_chunk,
    record_at,
)
from scan3d_twin.recording.mcap.recovering_reader import (
    MAGIC,
    READ_ERRORS,
    Channels,
    RawMessage,
    chunk_records,
    map_file,
    read_metadata,
    read_summary,
)

_MARKS = ((b"\x04\x00\x00\x00zstd", 37), (b"\x08\x00\x00\x00settings", 9),
          (b"\x0a\x00\x00\x00provenance", 9))  # fmt: skip
"""Bytes by which our records are found, and where they lie behind the beginning of the record."""


@dataclass(frozen=True)
class Salvage:
    """The sound records of a file.

    Attributes:
        path: The file.
        chunks: Where the sound chunks begin, in the order of the file.
        in_time: The same in the order of their times.
        metadata: The sound metadata records, in the order of the file.
        channels: All schemas and channels that are declared anywhere.
        lost_chunks: Number of chunks that are damaged or missing.
        lost_messages: Number of messages in them; None where nothing states it.
    """

    path: Path
    chunks: tuple[int, ...]
    in_time: tuple[int, ...]
    metadata: tuple[Metadata, ...]
    channels: Channels
    lost_chunks: int
    lost_messages: int | None

    def read(self, chunks: tuple[int, ...]) -> Iterator[RawMessage]:
        """Yield the messages of ``chunks``; those of undeclared channels are left out."""
        with map_file(self.path) as data:
            expansion = Expansion.of_file(len(data))
            for place in chunks:
                for record in chunk_records(data, place, expansion):
                    if isinstance(record, StoredMessage) and record.channel in self.channels:
                        yield self.channels.deliver(record)


def salvage(path: Path) -> Salvage:
    """Return what is sound in the file at ``path``.

    Raises:
        FileError: The file cannot be read, or expands to far more than its size.
    """
    with map_file(path) as data:
        try:
            return _salvage(path, data)
        except LimitError as error:
            raise FileError(f"{path} {error}") from None


def _salvage(path: Path, data: bytes) -> Salvage:
    # Take what the index says
    channels, stated, indexed, count = Channels({}, {}), 0, set[int](), None
    try:
        summary = read_summary(data)
        channels = Channels(summary.schemas, summary.channels)
        indexed = {each.chunk_start_offset for each in summary.chunk_indexes}
        stated = len(indexed)
        count = None if summary.statistics is None else summary.statistics.message_count
    except READ_ERRORS:
        pass

    # Open every chunk and metadata record
    expansion, chunks, metadata, damaged, kept = Expansion.of_file(len(data)), [], [], 0, 0
    for place in sorted(indexed | _walk(data) | _find_marks(data)):
        try:
            if record_at(data, place) is not None and data[place] == Opcode.METADATA:
                metadata.append(read_metadata(data, place))
                continue
            records = chunk_records(data, place, expansion)
        except LimitError:
            raise
        except READ_ERRORS:
            damaged += record_at(data, place) is not None  # else a kill cut it off
            continue
        for each in records:
            if isinstance(each, StoredMessage):
                kept += 1
            else:
                channels.declare(each)
        chunks.append((place, _end_time(data, place)))

    # Put them in order and count what is lost
    in_time = tuple(place for place, _ in sorted(chunks, key=lambda each: each[1]))
    places = tuple(place for place, _ in chunks)
    lost = max(stated - len(chunks), 0) if stated else damaged
    messages = max(count - kept, 0) if count is not None else (0 if lost == 0 else None)
    return Salvage(path, places, in_time, tuple(metadata), channels, lost, messages)


def _end_time(data: bytes, place: int) -> int:
    record = record_at(data, place)
    assert record is not None
    return parse_chunk(data[record.body : record.end]).times[1]


def _walk(data: bytes) -> set[int]:
    """Return where chunks and metadata begin, as far as the lengths of the records lead."""
    found, place = set(), len(MAGIC)
    while (record := record_at(data, place)) is not None and record.opcode != Opcode.DATA_END:
        if record.opcode in (Opcode.CHUNK, Opcode.METADATA):
            found.add(place)
        place = record.end
    return found


def _find_marks(data: bytes) -> set[int]:
    """Return where chunks and metadata begin by the bytes that mark them."""
    found = set()
    for mark, behind in _MARKS:
        opcode = Opcode.CHUNK if behind > 9 else Opcode.METADATA
        place = data.find(mark)
        while place >= 0:
            start = place - behind
            if start >= len(MAGIC) and data[start] == opcode:
                found.add(start)
            place = data.find(mark, place + 1)
    return found
