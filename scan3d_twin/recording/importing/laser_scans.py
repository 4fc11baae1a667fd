"""Sweeps out of the ``sensor_msgs/LaserScan`` messages of a ROS 2 recording.

The angle of the turning axis at the time of each beam comes from ``/tf``, or where nothing there
turns the lidar, from a joint of ``sensor_msgs/JointState``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import FloatArray
from scan3d_twin.limits import how_to_raise, scaled
from scan3d_twin.recording.importing.readings import (
    MAX_RANGE,
    MAX_READINGS,
    Readings,
    clean_ranges,
)
from scan3d_twin.recording.importing.ros_log import JOINTS, SCAN, TRANSFORMS, read_messages
from scan3d_twin.recording.importing.turning_frame import (
    FrameTree,
    TurningAxis,
    find_joint,
    find_turning_axis,
)
from scan3d_twin.recording.mcap.ros_messages import LASER_IN_LIDAR

MAX_ANGLE = 100.0
"""Largest angle of a beam that is believed [rad]: more than ten turns."""


@dataclass
class _Content:
    """What a recording holds.

    Attributes:
        scans: The scans of each topic.
        tree: The transforms.
        joints: Time [s] and position [rad] of each joint.
    """

    scans: dict[str, list[Any]] = field(default_factory=dict)
    tree: FrameTree = field(default_factory=FrameTree)
    joints: dict[str, list[tuple[float, float]]] = field(default_factory=dict)


def read_laser_scans(
    place: Path, topic: str | None = None, joint: str | None = None
) -> list[Readings]:
    """Return the readings in an MCAP file or rosbag2 folder.

    Args:
        place: The file or folder.
        topic: Topic of the scans; the only one by default.
        joint: Joint that turns the lidar; by default what turns it by ``/tf``, else the joint that
            turns most.

    Raises:
        FileError: It cannot be read, or does not say how the lidar was turned.
    """
    content = _read(place)
    scans = _choose_topic(content, topic, place)
    frame = str(scans[0].header.frame_id)
    axis = None if joint is not None else find_turning_axis(content.tree, frame)
    axis = axis or find_joint(content.joints, joint, str(place))
    if axis is None:
        raise FileError(
            f"{place}: nothing turns the frame {frame!r} of the scans: no transform on /tf and no "
            "joint on /joint_states turns by 5 deg"
        )
    return [_join(scans, axis, place)]


def _read(place: Path) -> _Content:
    """Return the scans, transforms and joints of a recording."""
    content, count = _Content(), 0
    for topic, kind, _, message in read_messages(place):
        if kind == SCAN:
            content.scans.setdefault(topic, []).append(message)
            count += len(message.ranges)
            if count > scaled(MAX_READINGS):
                raise FileError(f"{place} holds more than {count} readings; {how_to_raise()}")
        elif kind == TRANSFORMS:
            content.tree.add(message)
        elif kind == JOINTS:
            stamp = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
            for name, position in zip(message.name, message.position, strict=False):
                if math.isfinite(position):
                    content.joints.setdefault(str(name), []).append((stamp, float(position)))
    return content


def _choose_topic(content: _Content, topic: str | None, place: Path) -> list[Any]:
    """Return the scans of ``topic``, or of the only one that has any."""
    known = ", ".join(sorted(content.scans)) or "none"
    if topic is None and len(content.scans) == 1:
        (topic,) = content.scans
    if topic is None and content.scans:
        raise FileError(f"{place} holds scans on several topics; choose with --topic: {known}")
    if topic not in content.scans:
        raise FileError(f"{place}: no sensor_msgs/LaserScan on {topic or 'any topic'}; on: {known}")
    return sorted(content.scans[topic], key=_stamp)


def _stamp(scan: Any) -> float:
    return float(scan.header.stamp.sec) + float(scan.header.stamp.nanosec) / 1e9


def _join(scans: list[Any], axis: TurningAxis, place: Path) -> Readings:
    """Return the readings of all scans during which the angle of the axis is known."""
    # Describe the beams of each scan
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for scan in scans:
        first, step = float(scan.angle_min), float(scan.angle_increment)
        if not (abs(first) < MAX_ANGLE and abs(step) < MAX_ANGLE):
            raise FileError(f"{place}: a scan from {first:g} rad in steps of {step:g} rad")
        beams = np.arange(len(scan.ranges), dtype=np.float64)
        period = _beam_period(scan)
        times = np.asarray(_stamp(scan) + period * beams, dtype=np.float64)
        if len(beams) and np.all(np.isfinite(axis.at(times))):
            angles = np.asarray(first + step * beams)
            parts.append((times, angles, _valid_ranges(scan)))
    if not parts:
        raise FileError(f"{place}: the angle of {axis.name} is not known at the time of any scan")

    # Join them
    times, angles, ranges = (
        np.asarray(np.concatenate([part[k] for part in parts]), dtype=np.float64) for k in range(3)
    )
    nearest, farthest = float(scans[0].range_min), float(scans[0].range_max)
    laser = axis.T_axis_laser
    return Readings(
        str(place),
        np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts]),
        times,
        axis.at(times),
        angles,
        clean_ranges(ranges, str(place)),
        nearest if 0 < nearest < MAX_RANGE else 0.0,
        farthest if 0 < farthest < MAX_RANGE else math.nan,
        None if laser is None else laser @ np.linalg.inv(LASER_IN_LIDAR),
        axis.R_root_axis,
        axis.place_at(times),
    )


def _beam_period(scan: Any) -> float:
    """Return the time from one beam to the next [s]; drivers leave out ``time_increment``."""
    stated, turn = float(scan.time_increment), float(scan.scan_time)
    if math.isfinite(stated) and stated > 0:
        return stated
    share = abs(float(scan.angle_increment)) / math.tau
    return turn * share if math.isfinite(turn) and turn > 0 else 0.0


def _valid_ranges(scan: Any) -> FloatArray:
    """Return the ranges of ``scan`` (n,) [m]; NaN outside of its own limits."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    low, high = float(scan.range_min), float(scan.range_max)
    with np.errstate(invalid="ignore"):
        bad = ranges < low if math.isfinite(low) else np.zeros(len(ranges), dtype=bool)
        if math.isfinite(high) and high > 0:
            bad |= ranges > high
    return np.where(bad, np.nan, ranges)
