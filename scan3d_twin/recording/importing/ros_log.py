"""Reads the messages of ROS 2 recordings: MCAP files, and rosbag2 folders of MCAP or SQLite files.

Only messages that are needed are decoded, within the limits on chunks of session files.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.limits import how_to_raise, scaled
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.recovering_reader import RawMessage, read_contents

SCAN = "sensor_msgs/msg/LaserScan"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
JOINTS = "sensor_msgs/msg/JointState"
KINDS = (SCAN, TRANSFORMS, JOINTS)
"""Types of the messages that are read."""
ROS1_KINDS = tuple(kind.replace("/msg", "") for kind in KINDS)
"""Their names in recordings of ROS 1, whose encoding differs."""
DATABASE, MCAP = ".db3", ".mcap"
"""Suffixes of the files of a rosbag2 folder."""
METADATA = "metadata.yaml"
"""File by which a rosbag2 folder is known."""
MAX_MESSAGE = 128 * 1024 * 1024
"""Largest message of a database [bytes], as that of a chunk of an MCAP file."""


def is_rosbag2(folder: Path) -> bool:
    """Return whether ``folder`` is one of rosbag2."""
    return (folder / METADATA).is_file()


def read_messages(place: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Yield topic, type, time of recording [s] and content of each message of ``KINDS``.

    Args:
        place: An MCAP or SQLite file, or a rosbag2 folder.

    Raises:
        FileError: It cannot be read, is damaged, or holds messages of ROS 1.
    """
    store = ros.typestore()
    for each in _read_raw(place):
        if each.name in ROS1_KINDS:
            raise FileError(
                f"{place} holds messages of ROS 1 ({each.name}); convert it with "
                "`rosbags-convert --src FILE.bag --dst FOLDER`"
            )
        if each.name not in KINDS:
            continue
        try:
            content = store.deserialize_cdr(each.data, each.name)
        except Exception as error:  # noqa: BLE001 - rosbags compiles its decoders; any is damage
            raise FileError(f"{place}: a damaged message on {each.topic}: {error}") from None
        yield each.topic, each.name, each.nanoseconds / 1e9, content


def _read_raw(place: Path) -> Iterator[RawMessage]:
    if place.is_dir():
        files = sorted(p for p in place.iterdir() if p.suffix in (DATABASE, MCAP))
        if not files:
            packed = any(p.suffix == ".zstd" for p in place.iterdir())
            raise FileError(
                f"{place} holds no {MCAP} or {DATABASE} file"
                + ("; unpack its .zstd files first: unzstd FILE" if packed else "")
            )
        for path in files:
            yield from _read_raw(path)
    elif place.suffix == DATABASE:
        yield from _read_database(place)
    else:
        for each in read_contents(place):
            if isinstance(each, RawMessage):
                yield each


def _read_database(path: Path) -> Iterator[RawMessage]:
    """Yield the messages of the SQLite file of a rosbag2 folder.

    Only tables are read: a view could compute for ever. No value may exceed ``MAX_MESSAGE``.
    """
    query = (
        "SELECT topics.name, topics.type, messages.timestamp, messages.data FROM messages "
        "JOIN topics ON topics.id = messages.topic_id "
        "WHERE topics.type IN (?, ?, ?) AND length(messages.data) <= ? ORDER BY messages.timestamp"
    )
    limit = scaled(MAX_MESSAGE)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limit)
            kinds = dict(database.execute("SELECT name, type FROM sqlite_master"))
            if not kinds.get("topics") == kinds.get("messages") == "table":
                raise FileError(f"{path} is no database of rosbag2: no tables of its messages")
            (largest,) = database.execute("SELECT max(length(data)) FROM messages").fetchone()
            if isinstance(largest, int) and largest > limit:
                raise FileError(f"{path} holds a message of {largest} bytes; {how_to_raise()}")
            for topic, kind, stamp, data in database.execute(query, (*KINDS, limit)):
                if not (isinstance(data, bytes) and isinstance(stamp, int)):
                    raise FileError(f"{path} is no database of rosbag2")
                yield RawMessage(str(topic), str(kind), False, stamp, data)
    except sqlite3.Error as error:
        raise FileError(f"{path} is no database of rosbag2, or damaged: {error}") from None
