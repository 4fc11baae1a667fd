"""Encodes what viewers of ROS 2 messages draw: coloured clouds, the path, and viewpoints.

All of it is in ``world``. Every message is complete in itself, so that a viewer that shows only the
last one of a topic shows everything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Plan, Pose2
from scan3d_twin.recording.colours import GREY, pack_rgb, view_colours_rgb
from scan3d_twin.recording.mcap import ros_messages as ros

MODEL_VOXEL = 0.01
"""Side of the cubes of which each holds one point of the model in a recording [m]: the accuracy
that is asked for by default. The model is written anew with every view."""
PATH_STEP = 0.05
"""Distance between two poses of the path [m]: a fifth of the robot, so that bends show."""
_FLOAT32, _UINT16, _UINT8 = 7, 4, 2
_FIELDS = (
    ("x", 0, _FLOAT32),
    ("y", 4, _FLOAT32),
    ("z", 8, _FLOAT32),
    ("rgb", 12, _FLOAT32),
    ("view", 16, _UINT16),
    ("target", 18, _UINT8),
)
CLOUD = np.dtype(
    {
        "names": [name for name, _, _ in _FIELDS],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "u1"],
        "offsets": [offset for _, offset, _ in _FIELDS],
        "itemsize": 20,
    }
)
"""A point of ``sensor_msgs/PointCloud2``; ``rgb`` has the colour in the bits of a float, as PCL has
it; ``target`` is 1 on the target and 0 elsewhere."""
ARROW_LENGTH, ARROW_WIDTH = 0.25, 0.03
"""Size of a viewpoint's arrow [m]: about the radius of the robot, so that steps stay legible."""
NUMBER_HEIGHT = 0.12
"""Height of a viewpoint's number and of its place above the arrow [m]."""
CANDIDATE_WIDTH = 0.04
"""Diameter of a candidate's dot [m]."""
NEXT_COLOUR = (11, 98, 196)
"""Colour of the viewpoint that was chosen, as in the live view."""
INFEASIBLE_COLOUR = (200, 60, 60)
"""Colour of a candidate that the robot cannot reach."""


def encode_cloud(stamp: float, index: int, view: View) -> ros.Message:
    """Return all points of view ``index`` except the floor; grey where they are not the target."""
    is_target = find_target(view)
    views = np.full(len(is_target), index)
    colours = np.where(is_target[:, None], view_colours_rgb(views), np.array(GREY, dtype=np.uint8))
    points = view.T_world_scan.apply(view.sweep.points)
    return _encode_points(stamp, points, colours, views, is_target)


def encode_model(stamp: float, session: Session) -> ros.Message:
    """Return the target as all views of ``session`` show it, each where it is known to be now.

    Of the points in each cube of side ``MODEL_VOXEL`` the first one stands for all.
    """
    clouds = [view.T_world_scan.apply(view.target.points) for view in session.views]
    points = np.concatenate([np.zeros((0, 3)), *clouds])
    views = np.repeat(np.arange(len(clouds)), [len(each) for each in clouds])
    first = _first_in_each_cube(points)
    points, views = points[first], views[first]
    return _encode_points(stamp, points, view_colours_rgb(views), views, np.ones(len(points)))


def _first_in_each_cube(points: FloatArray) -> IntArray:
    """Return the indices of the first of ``points`` (n, 3) in each cube, in rising order."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    cubes = np.floor(points / MODEL_VOXEL).astype(np.int64)
    cubes -= cubes.min(axis=0)
    numbers = np.ravel_multi_index(tuple(cubes.T), tuple(cubes.max(axis=0) + 1))
    return np.sort(np.unique(numbers, return_index=True)[1])


def _encode_points(
    stamp: float, points: FloatArray, colours: npt.NDArray[np.uint8], views: IntArray, target: Any
) -> ros.Message:
    # Fill the points
    cloud = np.zeros(len(points), dtype=CLOUD)
    for axis, values in zip("xyz", points.T, strict=True):
        cloud[axis] = values
    cloud["rgb"], cloud["view"], cloud["target"] = pack_rgb(colours), views, target

    # Wrap them in a message
    return ros.encode(
        "sensor_msgs/msg/PointCloud2",
        header=ros.make_header(stamp, "world"),
        height=1,
        width=len(cloud),
        fields=[
            ros.make_message(
                "sensor_msgs/msg/PointField", name=name, offset=offset, datatype=kind, count=1
            )
            for name, offset, kind in _FIELDS
        ],
        is_bigendian=False,
        point_step=CLOUD.itemsize,
        row_step=CLOUD.itemsize * len(cloud),
        data=np.frombuffer(cloud.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def find_target(view: View) -> BoolArray:
    """Return which points (n,) of the sweep of a view are of the target."""
    beams = view.image.spec.n_beams
    places, target = (each.lines * beams + each.beams for each in (view.sweep, view.target))
    return np.isin(places, target)


def encode_path(stamp: float, poses: Sequence[tuple[float, Pose2]]) -> ros.Message:
    """Return the way of the robot so far, as stamps [s] and poses."""
    stamped = [
        ros.make_message(
            "geometry_msgs/msg/PoseStamped",
            header=ros.make_header(when, "world"),
            pose=ros.make_pose(pose),
        )
        for when, pose in poses
    ]
    return ros.encode("nav_msgs/msg/Path", header=ros.make_header(stamp, "world"), poses=stamped)


def encode_viewpoints(stamp: float, session: Session) -> ros.Message:
    """Return markers: views with their numbers, and what the last plan chose and considered.

    Their namespaces are ``views``, ``numbers``, ``next`` and ``candidates``.
    """
    markers = [_marker(stamp, "", 0, Pose2(), action=_DELETE_ALL)]
    for index, view in enumerate(session.views):
        colour = view_colours_rgb(np.array([index]))[0]
        markers += _arrow_with_number(stamp, index, view.T_world_scan, colour)
    if session.plans and len(session.plans) >= len(session.views):
        markers += _plan_markers(stamp, session.plans[-1])
    return ros.encode("visualization_msgs/msg/MarkerArray", markers=markers)


def _arrow_with_number(stamp: float, index: int, pose: Pose2, colour: Any) -> list[Any]:
    """Return what stands for view ``index``."""
    size = (0.0, 0.0, NUMBER_HEIGHT)
    return [
        _marker(stamp, "views", index, pose, kind=_ARROW, size=_ARROW_SIZE, colour=colour),
        _marker(
            stamp, "numbers", index, pose, z=NUMBER_HEIGHT, kind=_TEXT, size=size, colour=colour,
            text=str(index),
        ),
    ]  # fmt: skip


def _plan_markers(stamp: float, plan: Plan) -> Iterator[Any]:
    """Yield the candidates of ``plan`` and the viewpoint it chose."""
    for index, each in enumerate(plan.candidates):
        colour = GREY if each.feasible else INFEASIBLE_COLOUR
        size = (CANDIDATE_WIDTH,) * 3
        yield _marker(
            stamp, "candidates", index, each.viewpoint, kind=_SPHERE, size=size, colour=colour
        )
    if plan.viewpoint is not None:
        yield _marker(
            stamp, "next", 0, plan.viewpoint, kind=_ARROW, size=_ARROW_SIZE, colour=NEXT_COLOUR
        )


_ARROW, _SPHERE, _TEXT, _DELETE_ALL = 0, 2, 9, 3
"""Types of ``visualization_msgs/Marker``, and the action that removes all earlier ones."""
_ARROW_SIZE = (ARROW_LENGTH, ARROW_WIDTH, ARROW_WIDTH)


def _marker(
    stamp: float,
    namespace: str,
    index: int,
    pose: Pose2,
    *,
    kind: int = _ARROW,
    action: int = 0,
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    colour: Any = GREY,
    z: float = 0.0,
    text: str = "",
) -> Any:
    """Return a marker of a ``size`` along x, y and z [m] at the height ``z`` [m]."""
    place = ros.make_pose(pose)
    place.position.z = z
    red, green, blue = (float(channel) / 255 for channel in colour)
    return ros.make_message(
        "visualization_msgs/msg/Marker",
        header=ros.make_header(stamp, "world"),
        ns=namespace,
        id=index,
        type=kind,
        action=action,
        pose=place,
        scale=ros.make_message("geometry_msgs/msg/Vector3", x=size[0], y=size[1], z=size[2]),
        color=ros.make_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=ros.make_message("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=ros.make_message(
            "sensor_msgs/msg/CompressedImage",
            header=ros.make_header(0.0, ""),
            format="",
            data=np.zeros(0, dtype=np.uint8),
        ),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=ros.make_message(
            "visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, dtype=np.uint8)
        ),
        mesh_use_embedded_materials=False,
    )
