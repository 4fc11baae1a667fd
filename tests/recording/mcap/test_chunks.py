"""Small files that expand to much: refused before the memory is taken, read if they are trusted."""

import struct
import time
import tracemalloc

import pytest
import zstandard
from mcap import stream_reader
from mcap.opcode import Opcode
from recorded import record

from scan3d_twin import limits
from scan3d_twin.core.errors import FileError
from scan3d_twin.limits import VARIABLE
from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.mcap import chunks
from scan3d_twin.recording.mcap.chunks import (
    ChunkError,
    Expansion,
    LimitError,
    PackedChunk,
    expand,
    record_at,
    records_of,
)
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.recovering_reader import MAGIC, read_contents, read_summary
from scan3d_twin.recording.mcap.salvage import salvage

SIZE = 8_000_000
"""Bytes of a message of zeros, a thousand times what its file has."""


@pytest.fixture
def padded(tmp_path):
    """A session file with a message of zeros."""
    file = McapFile(tmp_path / "session.mcap", lambda: 0.0)
    file.write_bytes("/zeros", "std_msgs/msg/String", 0, bytes(SIZE))
    file.finish()
    return tmp_path / "session.mcap"


def test_what_a_file_expands_to_is_limited_before_it_is_decompressed(padded, monkeypatch):
    assert padded.stat().st_size < SIZE / 1000
    assert len(list(read_contents(padded))) == 1
    monkeypatch.setattr(limits, "FREE_EXPANSION", SIZE // 2)
    tracemalloc.start()
    for read in (
        lambda: list(read_contents(padded)),
        lambda: list(read_contents(padded, "/zeros")),
    ):
        with pytest.raises(FileError, match=f"expands to far more than its size.*{VARIABLE}=4"):
            read()
    with pytest.raises(FileError, match="expands to far more than its size"):
        salvage(padded)
    assert tracemalloc.get_traced_memory()[1] < SIZE / 4
    tracemalloc.stop()
    monkeypatch.setenv(VARIABLE, "4")
    assert len(list(read_contents(padded))) == 1


def test_a_chunk_is_no_larger_than_it_says():
    packed = zstandard.compress(bytes(SIZE))
    with pytest.raises(ChunkError, match="states two sizes"):
        expand(PackedChunk((0, 0), 100, 0, "zstd", packed), Expansion(SIZE * 2))
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(SIZE))
    with pytest.raises(ChunkError, match="cannot be decompressed"):
        expand(PackedChunk((0, 0), 100, 0, "zstd", unsized), Expansion(SIZE * 2))
    with pytest.raises(ChunkError, match=r"unknown compression 'x'"):
        expand(PackedChunk((0, 0), 100, 0, "x", packed), Expansion(SIZE * 2))


def test_the_number_of_records_is_limited(monkeypatch):
    empty = struct.pack("<BQ", 0x80, 0)  # an opcode for other programs, of no length
    assert records_of(empty * 100, Expansion(SIZE)) == []
    with pytest.raises(LimitError, match="expands to far more"):
        records_of(empty * 100, Expansion(99 * chunks.RECORD_COST))
    monkeypatch.setattr(chunks, "MAX_RECORDS", 99)
    with pytest.raises(LimitError, match="too many records"):
        records_of(empty * 100, Expansion(SIZE))


@pytest.mark.parametrize(
    ("content", "count"), [(struct.pack("<BQ", 0x80, 0) * 10_000, 60), (b"", 9000)]
)
def test_many_empty_things_take_no_time(tmp_path, content, count):
    """A file of a few kilobytes with millions of records, and one of thousands of chunks."""
    packed = zstandard.compress(content)
    name = struct.pack("<I", 4) + b"zstd"
    head = struct.pack("<QQQI", 0, 0, len(content), 0) + name + struct.pack("<Q", len(packed))
    chunk = struct.pack("<BQ", Opcode.CHUNK, len(head) + len(packed)) + head + packed
    (tmp_path / "session.mcap").write_bytes(MAGIC + chunk * count)
    for read in (lambda path: list(read_contents(path)), salvage):
        began = time.process_time()
        with pytest.raises(FileError, match="expands to far more than its size"):
            read(tmp_path / "session.mcap")
        assert time.process_time() - began < 5.0


def test_all_chunks_together_have_one_limit():
    expansion = Expansion(1000)
    for _ in range(10):
        expansion.spend(100)
    with pytest.raises(LimitError, match="expands to far more"):
        expansion.spend(1)


def test_zeros_are_no_records():
    assert record_at(bytes(100), 0) is None
    assert record_at(struct.pack("<BQ", Opcode.CHUNK, 0), 0) == (Opcode.CHUNK, 9, 9)
    assert record_at(struct.pack("<BQ", Opcode.CHUNK, 1), 0) is None


def test_a_session_of_a_real_run_is_far_from_the_limits(session, tmp_path, monkeypatch):
    path = record(tmp_path, session).path
    monkeypatch.setattr(limits, "FREE_EXPANSION", 0)
    monkeypatch.setattr(limits, "EXPANSION", 8)
    assert len(load_session(path).session.views) == len(session.views)


def test_a_false_start_of_the_index_opens_no_chunk_outside_the_limits(padded, monkeypatch):
    """The footer leads to a chunk: the library would decompress it, whatever its size."""
    data = bytearray(padded.read_bytes())
    (index,) = read_summary(bytes(data)).chunk_indexes
    footer = len(data) - len(MAGIC) - 20
    struct.pack_into("<Q", data, footer, index.chunk_start_offset)

    opened = []
    monkeypatch.setattr(
        stream_reader, "breakup_chunk", lambda *each, **_: opened.append(each) or ()
    )
    assert len(read_summary(bytes(data)).chunk_indexes) == 1
    assert opened == []
