"""The files of our writer against those of the library's."""

import io

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from scan3d_twin.recording.mcap.writer import McapWriter

CHUNK = 2000


def messages(count):
    """Yield channel, time and data of ``count`` random messages."""
    rng = np.random.default_rng(0)
    for k in range(count):
        yield (
            int(rng.integers(2)),
            10_000 * k + int(rng.integers(-50_000, 50_000)) + 60_000,
            bytes(rng.integers(0, 256, rng.integers(0, 300), dtype=np.uint8)),
        )


def ours(sent):
    """Return the file of our writer."""
    stream = io.BytesIO()
    writer = McapWriter(stream, CHUNK, "ros2", "test")
    writer.add_metadata("settings", {"name": "boxes", "toml": "a = 1"})
    schema = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channels = [
        writer.add_channel("/a", "cdr", schema, {}),
        writer.add_channel("/b", "cdr", schema, {"key": "value"}),
    ]
    for k, (channel, time, data) in enumerate(sent):
        writer.add_message(channels[channel], time, data)
        if k % 7 == 0:
            writer.flush()
    writer.add_metadata("settings", {"name": "boxes", "toml": "a = 2"})
    writer.finish()
    return stream.getvalue()


def the_librarys(sent):
    """Return the file of the mcap package's writer."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
    writer.start("ros2", "test")
    writer.add_metadata("settings", {"name": "boxes", "toml": "a = 1"})
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channels = [
        writer.register_channel("/a", "cdr", schema, {}),
        writer.register_channel("/b", "cdr", schema, {"key": "value"}),
    ]
    for k, (channel, time, data) in enumerate(sent):
        writer.add_message(channels[channel], time, data, time)
        if k % 7 == 0:
            writer.flush()
    writer.add_metadata("settings", {"name": "boxes", "toml": "a = 2"})
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("count", [0, 1, 200])
def test_the_bytes_are_those_of_the_library(count):
    sent = list(messages(count))
    assert ours(sent) == the_librarys(sent)


def test_the_library_reads_back_what_was_written():
    sent = list(messages(200))
    reader = make_reader(io.BytesIO(ours(sent)), validate_crcs=True)
    found = [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages()]
    wanted = sorted((("/a", "/b")[channel], time, data) for channel, time, data in sent)
    assert sorted(found) == wanted
