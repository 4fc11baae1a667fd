"""Encodes what a run records as ROS 2 messages, so that ROS tools open a session file directly.

Frames (as REP 105): ``world`` > ``odom`` > ``base`` > ``laser``. Frame ``laser`` is the lidar's,
turned so that its beams lie in the x-y plane, as ``sensor_msgs/LaserScan`` has it. Time is the
robot's clock.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scan3d_twin.core.types import FloatArray, Pose2

OWN_TYPES = {
    "scan3d_twin_msgs/msg/Record": """
builtin_interfaces/Time stamp
string kind
uint32 index
string json
uint8[] data
""",
    "scan3d_twin_msgs/msg/SerialBytes": """
builtin_interfaces/Time stamp
string direction
uint8[] data
""",
    "scan3d_twin_msgs/msg/ScanAngles": """
std_msgs/Header header
float64[] elevations
float64[] times
""",
    "scan3d_twin_msgs/msg/Candidate": """
geometry_msgs/Pose viewpoint
float64 overlap
float64 predicted_rmse
bool feasible
""",
    "scan3d_twin_msgs/msg/Plan": """
std_msgs/Header header
uint32 view
bool finished
geometry_msgs/Pose viewpoint
float64 overlap
float64 predicted_rmse
bool fell_back
bool needs_panorama
string reason
scan3d_twin_msgs/Candidate[] candidates
""",
    "scan3d_twin_msgs/msg/Registration": """
std_msgs/Header header
uint32 view
bool converged
geometry_msgs/PoseWithCovariance target_source
float64 fitness
float64 inlier_rmse
float64 predicted_rmse
uint32 num_inliers
uint32 iterations
float64 ambiguity_gap
""",
}
"""Messages that ROS 2 has no type for; a session file holds these definitions."""
LASER_IN_LIDAR = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""``T_lidar_laser``: the scan plane, x ahead and z up in ``lidar``, is x-y in ``laser``."""


class Message(NamedTuple):
    """An encoded message.

    Attributes:
        kind: Its type, such as ``std_msgs/msg/Header``.
        data: The message as CDR.
    """

    kind: str
    data: bytes


@cache
def typestore() -> Any:
    """Return the message types of ROS 2 and our own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


def make_message(kind: str, /, **fields: Any) -> Any:
    """Return the message of type ``kind``, such as ``std_msgs/msg/Header``, not yet encoded."""
    return typestore().types[kind](**fields)


def encode(kind: str, /, **fields: Any) -> Message:
    """Return the message of type ``kind`` with these ``fields``."""
    return Message(kind, bytes(typestore().serialize_cdr(make_message(kind, **fields), kind)))


def split_stamp(stamp: float) -> tuple[int, int]:
    """Return ``stamp`` [s] as whole seconds and nanoseconds."""
    return divmod(round(stamp * 1e9), 1_000_000_000)


def make_time(stamp: float) -> Any:
    """Return ``stamp`` [s] as a ROS time, to the nanosecond."""
    seconds, rest = split_stamp(stamp)
    return make_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def make_header(stamp: float, frame: str) -> Any:
    """Return a header."""
    return make_message("std_msgs/msg/Header", stamp=make_time(stamp), frame_id=frame)


def _find_quaternion(R: FloatArray) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of a rotation ``R`` (3, 3), with w >= 0.

    By its largest part, so that no small number divides.
    """
    (a, b, c), trace = np.diagonal(R).tolist(), float(np.trace(R))
    (_, r01, r02), (r10, _, r12), (r20, r21, _) = R.tolist()
    parts = {
        a: (1 - trace + 2 * a, r10 + r01, r20 + r02, r21 - r12),
        b: (r10 + r01, 1 - trace + 2 * b, r21 + r12, r02 - r20),
        c: (r20 + r02, r21 + r12, 1 - trace + 2 * c, r10 - r01),
        trace: (r21 - r12, r02 - r20, r10 - r01, 1 + trace),
    }
    largest = parts[max(parts)]
    length = math.copysign(math.hypot(*largest), largest[3])
    x, y, z, w = (part / length + 0.0 for part in largest)
    return x, y, z, w


def encode_mount(T_base_lidar: FloatArray, stamp: float = 0.0) -> Message:
    """Return the lidar's extrinsics as a transform from ``base`` to ``laser``, at ``stamp`` [s]."""
    # Compose rotation and translation
    T = T_base_lidar @ LASER_IN_LIDAR
    x, y, z, w = _find_quaternion(T[:3, :3])
    rotation = make_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    place = make_message(
        "geometry_msgs/msg/Vector3", **dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    )

    # Wrap them in a transform
    edge = make_message(
        "geometry_msgs/msg/TransformStamped",
        header=make_header(stamp, "base"),
        child_frame_id="laser",
        transform=make_message("geometry_msgs/msg/Transform", translation=place, rotation=rotation),
    )
    return encode("tf2_msgs/msg/TFMessage", transforms=[edge])


def make_pose(planar: Pose2) -> Any:
    """Return a planar pose."""
    z, w = yaw_quaternion(planar.yaw)
    return make_message(
        "geometry_msgs/msg/Pose",
        position=make_message("geometry_msgs/msg/Point", x=planar.x, y=planar.y, z=0.0),
        orientation=make_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w),
    )


def yaw_quaternion(yaw: float) -> tuple[float, float]:
    """Return z and w of the unit quaternion that turns about z by ``yaw`` in [-pi, pi) [rad]."""
    return math.sin(yaw / 2), math.cos(yaw / 2)


def encode_viewpoint(stamp: float, where: Pose2) -> Message:
    """Return the next viewpoint in ``world``."""
    return encode(
        "geometry_msgs/msg/PoseStamped", header=make_header(stamp, "world"), pose=make_pose(where)
    )
