"""Test helper: sweeps as scanners of others would write them."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.spatial.transform import Rotation

from scan3d_twin.core.types import FloatArray, Pose2, RangeImage
from scan3d_twin.recording.mcap import ros_messages as ros

START = 10.0
"""Time of the first line [s]."""
TF_PERIOD = 0.01
"""Time between two transforms [s]."""
RATE = math.radians(15.0)
"""Speed of the turning axis [rad/s]."""


def turn_like_a_robot(image: RangeImage) -> RangeImage:
    """Return ``image`` as if the axis had turned on while each line was measured."""
    stamps = image.stamps + START
    times = stamps[:, None] + image.spec.beam_times
    return replace(image, stamps=stamps, yaws=-RATE * (times - times.mean()))


def _lines(image: RangeImage) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Yield stamp, yaws and ranges of each line, in the order of time."""
    for k in np.argsort(image.stamps):
        yield float(image.stamps[k]), image.yaws[k], image.ranges[k]


def write_readings(path: Path, image: RangeImage, *, units: str = "s,deg,deg,m") -> None:
    """Write a CSV file with a reading per row."""
    time, axis, angle, length = units.split(",")
    scale = {"s": 1.0, "ms": 1e3, "deg": math.degrees(1.0), "rad": 1.0, "m": 1.0, "mm": 1e3}
    rows = [f"time_{time},axis_{axis},angle_{angle},range_{length}"]
    for stamp, yaws, ranges in _lines(image):
        for t, yaw, e, r in zip(
            image.spec.beam_times, yaws, image.spec.elevations, ranges, strict=True
        ):
            shown = "" if np.isnan(r) else f"{scale[length] * r:.6f}"
            rows.append(
                f"{scale[time] * (stamp + t):.7f},{scale[axis] * yaw:.7f},"
                f"{scale[angle] * e:.7f},{shown}"
            )
    path.write_text("\n".join(rows) + "\n")


def write_lines(path: Path, image: RangeImage) -> None:
    """Write a CSV file with a line per row, separated by semicolons, with decimal commas."""
    beam = float(np.median(np.diff(image.spec.beam_times)))
    rows = ["time_s;axis_rad;angle_rad;range_m;angle_rad;range_m"]
    for stamp, yaws, ranges in _lines(image):
        pairs = [
            f"{e:.7f};{'' if np.isnan(r) else f'{r:.6f}'}"
            for e, r in zip(image.spec.elevations, ranges, strict=True)
        ]
        rows.append(";".join([f"{stamp:.7f}", f"{yaws[0]:.8f}", *pairs]))
    path.write_text(f"# beam_s: {beam!r}\n" + "\n".join(rows).replace(".", ",") + "\n")


def write_pilidar(path: Path, image: RangeImage, *, protocol: int = 4) -> None:
    """Write ``image``, of a lidar on PiLiDAR's mount, as its raw scan."""
    planes = []
    for k in range(image.n_lines):
        r = np.nan_to_num(image.ranges[k]) * 1000.0
        e = image.spec.elevations
        planes.append(np.stack([r * np.cos(e), r * np.sin(e), 100.0 * np.ones(len(e))], axis=1))
    content = {
        "header": {"scan_id": "240824-1230", "device_id": None},
        "z_angles": [np.degrees(-image.yaws[k, 0]) for k in range(image.n_lines)],
        "angular": None,
        "cartesian": [plane.astype(np.float32) for plane in planes],
    }
    path.write_bytes(pickle.dumps(content, protocol=protocol))


def write_laser_scans(
    folder: Path,
    image: RangeImage,
    *,
    joint: bool = False,
    lever: bool = False,
    storage: StoragePlugin = StoragePlugin.MCAP,
) -> None:
    """Write a rosbag2 folder: scans in frame ``laser``, and what turns it, as /tf or as a joint.

    With a ``lever`` the frame ``laser`` itself turns, away from the axis.
    """
    turning = _joints(image) if joint else _transforms(image, lever=lever)
    messages = [*_scan_messages(image), *turning]
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        topics = {}
        for topic, stamp, message in sorted(messages, key=lambda each: each[1]):
            if topic not in topics:
                topics[topic] = writer.add_connection(
                    topic, message.kind, typestore=ros.typestore()
                )
            writer.write(topics[topic], round(stamp * 1e9), message.data)


def _scan_messages(image: RangeImage) -> Iterator[tuple[str, float, ros.Message]]:
    e, t = image.spec.elevations, image.spec.beam_times
    for stamp, _, ranges in _lines(image):
        scan = ros.encode(
            "sensor_msgs/msg/LaserScan",
            header=ros.make_header(stamp, "laser"),
            angle_min=float(e[0]),
            angle_max=float(e[-1]),
            angle_increment=float(np.median(np.diff(e))),
            time_increment=float(np.median(np.diff(t))),
            scan_time=image.spec.line_period,
            range_min=image.spec.min_range,
            range_max=image.spec.max_range,
            ranges=np.where(np.isnan(ranges), np.inf, ranges).astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )
        yield "/lidar/scan", stamp, scan


def _clock(image: RangeImage) -> FloatArray:
    first, last = float(image.stamps.min()), float(image.stamps.max()) + image.spec.line_period
    return np.arange(first - TF_PERIOD, last + TF_PERIOD, TF_PERIOD)


def _axis_at(image: RangeImage, times: FloatArray) -> FloatArray:
    """Return the axis at ``times`` (n,), as the readings of ``image`` have it."""
    every = (image.stamps[:, None] + image.spec.beam_times).ravel()
    order = np.argsort(every)
    fit = np.polyfit(every[order], image.yaws.ravel()[order], 1)
    return np.polyval(fit, times)


def _transforms(
    image: RangeImage, *, lever: bool = False
) -> Iterator[tuple[str, float, ros.Message]]:
    """Yield the mount, and the frame ``base`` that turns about z of a frame that may lie."""
    mount = image.T_base_lidar @ ros.LASER_IN_LIDAR
    if not lever:
        yield "/tf_static", 0.0, ros.encode_mount(image.T_base_lidar)
    if image.T_scan_axis is not None:
        yield "/tf_static", 0.0, _edge(0.0, "floor", "stand", image.T_scan_axis)
    for stamp, yaw in zip(_clock(image), _axis_at(image, _clock(image)), strict=True):
        T = Pose2(3.0, 1.0, yaw).matrix()
        child, T = ("laser", T @ mount) if lever else ("base", T)
        yield "/tf", stamp, _edge(stamp, "stand", child, T)


def _edge(stamp: float, parent: str, child: str, T: FloatArray) -> ros.Message:
    x, y, z, w = map(float, Rotation.from_matrix(T[:3, :3]).as_quat())
    place = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    edge = ros.make_message(
        "geometry_msgs/msg/TransformStamped",
        header=ros.make_header(stamp, parent),
        child_frame_id=child,
        transform=ros.make_message(
            "geometry_msgs/msg/Transform",
            translation=ros.make_message("geometry_msgs/msg/Vector3", **place),
            rotation=ros.make_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )
    return ros.encode("tf2_msgs/msg/TFMessage", transforms=[edge])


def _joints(image: RangeImage) -> Iterator[tuple[str, float, ros.Message]]:
    for stamp, yaw in zip(_clock(image), _axis_at(image, _clock(image)), strict=True):
        yield "/joint_states", stamp, ros.encode(
            "sensor_msgs/msg/JointState",
            header=ros.make_header(stamp, ""),
            name=["wheel", "pan"],
            position=np.array([0.001, yaw]),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )  # fmt: skip
