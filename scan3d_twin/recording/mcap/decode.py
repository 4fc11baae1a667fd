"""Decodes messages of a session file; a message that is damaged or of another type is an error."""

from __future__ import annotations

from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.recovering_reader import RawMessage
from scan3d_twin.recording.names import ANGLES, COMMANDS, ODOMETRY, RECORDS, SCANS

TYPES = {
    ANGLES: "scan3d_twin_msgs/msg/ScanAngles",
    COMMANDS: "geometry_msgs/msg/TwistStamped",
    ODOMETRY: "nav_msgs/msg/Odometry",
    RECORDS: "scan3d_twin_msgs/msg/Record",
    SCANS: "sensor_msgs/msg/LaserScan",
}
"""Types of the topics that are read back."""


def decode_message(each: RawMessage) -> Any:
    """Return the message, decoded by the type that its topic has.

    Raises:
        FileError: It is of another type, or damaged.
    """
    if each.name != TYPES.get(each.topic, each.name):
        raise FileError(f"a message of type {each.name} on {each.topic}: no session of twin")
    try:
        return ros.typestore().deserialize_cdr(each.data, each.name)
    except Exception as error:  # noqa: BLE001 - rosbags compiles its decoders; any error is damage
        raise FileError(f"a damaged message on {each.topic}: {error}") from None
