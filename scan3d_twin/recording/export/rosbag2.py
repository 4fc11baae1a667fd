"""A session as a rosbag2 folder, for ``ros2 bag play`` and everything that reads bags."""

from __future__ import annotations

import secrets
import shutil
from pathlib import Path

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.export.format import RecordingFormat
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.recovering_reader import RawMessage, read_contents

_FOREVER = QosTime(2**31 - 1, 999_999_999)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    avoid_ros_namespace_conventions=False,
)
"""Quality of service of the static transforms: late subscribers receive them too."""


def write(session_file: Path, path: Path) -> int:
    """Write the messages of ``session_file`` as the rosbag2 folder ``path``; return their number.

    Scan lines, odometry, transforms, clouds, plans and registrations are copied unchanged.

    Raises:
        FileError: The folder exists, or cannot be written.
    """
    part = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            raise FileError(f"{path} exists; name another folder with --out")
        count = _copy(session_file, part)
        _rename_inside(part, path.name)
        part.replace(path)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error
    except WriterError as error:
        raise FileError(f"cannot write {path}: {error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return count


def _copy(session_file: Path, folder: Path) -> int:
    store, topics, count = ros.typestore(), {}, 0
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for each in read_contents(session_file):
            if not isinstance(each, RawMessage):
                continue

            # Declare a topic once
            if each.topic not in topics:
                topics[each.topic] = writer.add_connection(
                    each.topic,
                    each.name,
                    typestore=store,
                    offered_qos_profiles=[LATCHED] if each.latched else [],
                )

            # Copy the message
            writer.write(topics[each.topic], each.nanoseconds, each.data)
            count += 1
    return count


def _rename_inside(folder: Path, name: str) -> None:
    """Name the data file after the final folder, as rosbag2 does, here and in the metadata."""
    metadata = folder / "metadata.yaml"
    (data,) = folder.glob("*.mcap")
    final = folder / f"{name}.mcap"
    metadata.write_text(metadata.read_text().replace(data.name, final.name))
    data.rename(final)


ROSBAG2 = RecordingFormat(write=write)
