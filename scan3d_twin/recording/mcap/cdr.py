"""Fast CDR encoders of the messages that come many times a second.

Each has a fixed layout, so that one struct takes a tenth of the time of rosbags' general encoder
and its objects. The bytes are the same: CDR, little endian, every number aligned to its size.
"""

from __future__ import annotations

from struct import Struct
from typing import Literal

import numpy as np

from scan3d_twin.core.types import LidarSpec, Odometry, Pose2, ScanLine
from scan3d_twin.recording.exact_json import Packed
from scan3d_twin.recording.mcap.ros_messages import Message, split_stamp, yaw_quaternion

_CDR = b"\x00\x01\x00\x00"
_POSE = "2d 24x 2d"
"""Planar pose: x and y, then z and w of the quaternion."""
_TWIST = "d 32x d"
"""Planar twist: speed along x and turn rate about z."""
_COVARIANCE = "2d 24x d 2d 24x d 144x 2d 24x d"
"""Planar covariance: rows and columns of x, y and yaw in a (6, 6) matrix."""

_ODOMETRY = Struct(f"<4s iI 12s 12s {_POSE} {_COVARIANCE} {_TWIST} 288x")
_COMMAND = Struct(f"<4s iI 16s {_TWIST}")
_FRAMES = Struct(f"<4s I iI 12s 16s {_POSE} iI 12s 12s {_POSE}")
_SCAN = Struct("<4s iI 12s 7f")
_SERIAL = Struct("<4s iI 8s")
_RECORD = Struct("<4s iI")
_COUNT = Struct("<I")


def _text(text: str) -> bytes:
    """Return ``text`` with its length; the struct pads it to the alignment of the next number."""
    return _COUNT.pack(len(text) + 1) + text.encode() + b"\0"


_WORLD, _ODOM, _BASE, _LASER = map(_text, ("world", "odom", "base", "laser"))


def encode_odometry(sample: Odometry, before: Odometry | None) -> Message:
    """Return an odometry sample, with the mean velocity since the one ``before``."""
    pose = sample.T_odom_base
    data = _ODOMETRY.pack(
        _CDR,
        *split_stamp(sample.stamp),
        _ODOM,
        _BASE,
        pose.x,
        pose.y,
        *yaw_quaternion(pose.yaw),
        *sample.covariance.ravel().tolist(),
        *_velocity(sample, before),
    )
    return Message("nav_msgs/msg/Odometry", data)


def _velocity(sample: Odometry, before: Odometry | None) -> tuple[float, float]:
    """Return the mean speed [m/s] and turn rate [rad/s] since the sample ``before``."""
    if before is None or sample.stamp <= before.stamp:
        return 0.0, 0.0
    move = before.T_odom_base.inverse() @ sample.T_odom_base
    period = sample.stamp - before.stamp
    return move.x / period, move.yaw / period


def encode_command(stamp: float, linear: float, angular: float) -> Message:
    """Return a velocity command [m/s, rad/s] that was sent to the base."""
    data = _COMMAND.pack(_CDR, *split_stamp(stamp), _BASE, linear, angular)
    return Message("geometry_msgs/msg/TwistStamped", data)


def encode_frames(stamp: float, T_world_odom: Pose2, T_odom_base: Pose2) -> Message:
    """Return the transforms from ``world`` to ``odom`` and from ``odom`` to ``base``."""
    time, (outer, inner) = split_stamp(stamp), (T_world_odom, T_odom_base)
    data = _FRAMES.pack(
        _CDR,
        2,
        *time,
        _WORLD,
        _ODOM,
        outer.x,
        outer.y,
        *yaw_quaternion(outer.yaw),
        *time,
        _ODOM,
        _BASE,
        inner.x,
        inner.y,
        *yaw_quaternion(inner.yaw),
    )
    return Message("tf2_msgs/msg/TFMessage", data)


def encode_scan(line: ScanLine, spec: LidarSpec) -> Message:
    """Return a scan line; its intensities are the sensor's error codes, -1 where measured.

    A ``LaserScan`` has evenly spaced beams: those of a line that has its own elevations are stated
    to lie at the nominal ones.
    """
    # Write the header
    steps = max(1, spec.n_beams - 1)
    first, last = float(spec.elevations[0]), float(spec.elevations[-1])
    head = _SCAN.pack(
        _CDR,
        *split_stamp(line.stamp),
        _LASER,
        first,
        last,
        (last - first) / steps,
        float(spec.beam_times[-1] - spec.beam_times[0]) / steps,
        spec.line_period,
        spec.min_range,
        spec.max_range,
    )

    # Append ranges and codes
    count = _COUNT.pack(len(line.ranges))
    ranges, codes = (each.astype(np.float32).tobytes() for each in (line.ranges, line.codes))
    return Message("sensor_msgs/msg/LaserScan", b"".join((head, count, ranges, count, codes)))


def encode_serial_bytes(stamp: float, direction: Literal["<", ">"], data: bytes) -> Message:
    """Return ``data`` that came from (<) or went to (>) a device."""
    head = _SERIAL.pack(_CDR, *split_stamp(stamp), _text(direction))
    return Message("scan3d_twin_msgs/msg/SerialBytes", head + _COUNT.pack(len(data)) + data)


def encode_record(stamp: float, kind: str, index: int, packed: Packed) -> Message:
    """Return a record of the session log, stored bit by bit; its megabytes are copied once."""
    text, blob = packed
    head = _RECORD.pack(_CDR, *split_stamp(stamp))
    parts = (head, _aligned(_text(kind)), _COUNT.pack(index), _aligned(_text(text)))
    return Message("scan3d_twin_msgs/msg/Record", b"".join((*parts, _COUNT.pack(len(blob)), blob)))


def _aligned(text: bytes) -> bytes:
    """Return ``text`` with zeros up to the alignment of a count after it."""
    return text + bytes(-len(text) % _COUNT.size)
