"""What is recorded as ROS 2 messages, so that the tools of that world open a session unchanged.

Frames (as REP 105): ``world`` > ``odom`` > ``base`` > ``laser``. Frame ``laser`` is the lidar's,
turned so that its beams lie in the x-y plane, as ``sensor_msgs/LaserScan`` has it. Time is the
robot's clock.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from scan3d_twin.core.session import View
from scan3d_twin.core.types import FloatArray, IntArray, LidarSpec, Odometry, Pose2, ScanLine

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
bool needs_look
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
_FLOAT32, _UINT16, _UINT8 = 7, 4, 2
_CLOUD_FIELDS = (
    ("x", 0, _FLOAT32),
    ("y", 4, _FLOAT32),
    ("z", 8, _FLOAT32),
    ("view", 12, _UINT16),
    ("target", 14, _UINT8),
)
CLOUD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("view", "<u2"), ("target", "u1")])
"""A point of ``sensor_msgs/PointCloud2``; ``target`` is 1 on the target and 0 elsewhere."""


@cache
def typestore() -> Any:
    """Return the messages of ROS 2 and our own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN_TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


def new(kind: str, /, **fields: Any) -> Any:
    """Return the message of type ``kind``, such as ``std_msgs/msg/Header``."""
    return typestore().types[kind](**fields)


def time_of(stamp: float) -> Any:
    """Return ``stamp`` [s] as ROS has it, to the nanosecond."""
    seconds, rest = divmod(round(stamp * 1e9), 1_000_000_000)
    return new("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def header(stamp: float, frame: str) -> Any:
    """Return a header."""
    return new("std_msgs/msg/Header", stamp=time_of(stamp), frame_id=frame)


def scan(line: ScanLine, spec: LidarSpec) -> Any:
    """Return a scan line; its intensities are the sensor's error codes, -1 where measured."""
    steps = max(1, spec.n_beams - 1)
    first, last = float(spec.elevations[0]), float(spec.elevations[-1])
    return new(
        "sensor_msgs/msg/LaserScan",
        header=header(line.stamp, "laser"),
        angle_min=first,
        angle_max=last,
        angle_increment=(last - first) / steps,
        time_increment=float(spec.beam_times[-1] - spec.beam_times[0]) / steps,
        scan_time=spec.line_period,
        range_min=spec.min_range,
        range_max=spec.max_range,
        ranges=line.ranges.astype(np.float32),
        intensities=line.codes.astype(np.float32),
    )


def odometry(sample: Odometry, before: Odometry | None) -> Any:
    """Return a sample of the odometry, with the velocity since the one ``before``."""
    covariance = np.zeros((6, 6))
    covariance[np.ix_((0, 1, 5), (0, 1, 5))] = sample.covariance
    return new(
        "nav_msgs/msg/Odometry",
        header=header(sample.stamp, "odom"),
        child_frame_id="base",
        pose=new(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=pose(sample.T_odom_base),
            covariance=covariance.ravel(),
        ),
        twist=new(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=_velocity(sample, before),
            covariance=np.zeros(36),
        ),
    )


def _velocity(sample: Odometry, before: Odometry | None) -> Any:
    if before is None or sample.stamp <= before.stamp:
        return twist(0.0, 0.0)
    move = before.T_odom_base.inverse() @ sample.T_odom_base
    period = sample.stamp - before.stamp
    return twist(move.x / period, move.yaw / period)


def twist(linear: float, angular: float) -> Any:
    """Return the velocity of a base [m/s], [rad/s]."""
    return new(
        "geometry_msgs/msg/Twist",
        linear=_vector(linear, 0.0, 0.0),
        angular=_vector(0.0, 0.0, angular),
    )


def command(stamp: float, linear: float, angular: float) -> Any:
    """Return a velocity that was sent to the base."""
    return new(
        "geometry_msgs/msg/TwistStamped",
        header=header(stamp, "base"),
        twist=twist(linear, angular),
    )


def transforms(stamp: float, *edges: tuple[str, str, Pose2]) -> Any:
    """Return (parent, child, T) of each of the ``edges`` of the tree of frames."""
    return new(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            _transform(stamp, parent, child, _vector(T.x, T.y, 0.0), _heading(T.yaw))
            for parent, child, T in edges
        ],
    )


def mount(T_base_lidar: FloatArray) -> Any:
    """Return where the lidar sits on the base, as a transform that never changes."""
    T = T_base_lidar @ LASER_IN_LIDAR
    x, y, z, w = map(float, Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    rotation = new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    edge = _transform(0.0, "base", "laser", _vector(*map(float, T[:3, 3])), rotation)
    return new("tf2_msgs/msg/TFMessage", transforms=[edge])


def _transform(stamp: float, parent: str, child: str, translation: Any, rotation: Any) -> Any:
    return new(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp, parent),
        child_frame_id=child,
        transform=new("geometry_msgs/msg/Transform", translation=translation, rotation=rotation),
    )


def pose(planar: Pose2) -> Any:
    """Return a planar pose."""
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", x=planar.x, y=planar.y, z=0.0),
        orientation=_heading(planar.yaw),
    )


def _heading(yaw: float) -> Any:
    """Return a turn about z by ``yaw`` in [-pi, pi) [rad] as a unit quaternion."""
    z, w = math.sin(yaw / 2), math.cos(yaw / 2)
    return new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)


def _vector(x: float, y: float, z: float) -> Any:
    return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def viewpoint(stamp: float, where: Pose2) -> Any:
    """Return where the robot is to go next, in ``world``."""
    return new("geometry_msgs/msg/PoseStamped", header=header(stamp, "world"), pose=pose(where))


def cloud(stamp: float, index: int, view: View) -> Any:
    """Return all points of view ``index`` in ``world``, except the floor."""
    points = np.zeros(len(view.sweep), dtype=CLOUD)
    for axis, values in zip("xyz", view.T_world_scan.apply(view.sweep.points).T, strict=True):
        points[axis] = values
    points["view"] = index
    places, target = (_places(each.lines, each.beams, view) for each in (view.sweep, view.target))
    points["target"] = np.isin(places, target)
    return new(
        "sensor_msgs/msg/PointCloud2",
        header=header(stamp, "world"),
        height=1,
        width=len(points),
        fields=[_cloud_field(*each) for each in _CLOUD_FIELDS],
        is_bigendian=False,
        point_step=CLOUD.itemsize,
        row_step=CLOUD.itemsize * len(points),
        data=points.view(np.uint8),
        is_dense=True,
    )


def _places(lines: IntArray, beams: IntArray, view: View) -> IntArray:
    return lines * view.image.spec.n_beams + beams


def _cloud_field(name: str, offset: int, datatype: int) -> Any:
    return new("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
