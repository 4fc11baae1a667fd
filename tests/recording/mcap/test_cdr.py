"""The messages encoded by hand are those of rosbags, byte by byte."""

import math

import numpy as np
import pytest
from recorded import line
from synthetic import spec

from scan3d_twin.core.types import Odometry, Pose2
from scan3d_twin.recording.mcap import cdr
from scan3d_twin.recording.mcap import ros_messages as ros

COVARIANCE = np.arange(1.0, 10.0).reshape(3, 3)
BEFORE = Odometry(12.0, Pose2(1.0, -2.0, 0.5), np.zeros((3, 3)))
SAMPLE = Odometry(12.015, Pose2(1.25, -2.5, -3.0), COVARIANCE)
MESSAGES = {
    "odometry": cdr.encode_odometry(SAMPLE, BEFORE),
    "the first odometry": cdr.encode_odometry(SAMPLE, None),
    "a command": cdr.encode_command(1.5, 0.2, -0.7),
    "frames": cdr.encode_frames(1e6 + 0.25, Pose2(1.0, 2.0, 3.0), Pose2(-1.0, -2.0, -0.5)),
    "a line": cdr.encode_scan(line(3.000000001), spec()),
    "bytes": cdr.encode_serial_bytes(0.75, ">", b"\x80\x83\x01"),
    "no bytes": cdr.encode_serial_bytes(0.75, "<", b""),
    "a record": cdr.encode_record(2.5, "views", 3, ('{"a":[1]}', bytes(range(11)))),
    "an empty record": cdr.encode_record(0.0, "mark", 0, ("{}", b"")),
}


def decoded(message):
    """Return ``message`` as rosbags decodes it."""
    return ros.typestore().deserialize_cdr(message.data, message.kind)


@pytest.mark.parametrize("name", MESSAGES)
def test_rosbags_encodes_the_same_bytes(name):
    message = MESSAGES[name]
    again = ros.typestore().serialize_cdr(decoded(message), message.kind)
    assert bytes(again) == message.data


def test_odometry_keeps_pose_covariance_and_velocity():
    read = decoded(MESSAGES["odometry"])
    assert (read.header.frame_id, read.child_frame_id) == ("odom", "base")
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (12, 15_000_000)
    pose = read.pose.pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.25, -2.5, 0.0)
    assert (pose.orientation.x, pose.orientation.y) == (0.0, 0.0)
    assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(-3.0)
    covariance = read.pose.covariance.reshape(6, 6)
    assert np.array_equal(covariance[np.ix_((0, 1, 5), (0, 1, 5))], COVARIANCE)
    assert not covariance[2:5].any()
    assert not covariance[:, 2:5].any()
    move = BEFORE.T_odom_base.inverse() @ SAMPLE.T_odom_base
    twist = read.twist.twist
    assert twist.linear.x == pytest.approx(move.x / 0.015)
    assert twist.angular.z == pytest.approx(move.yaw / 0.015)
    assert (twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y) == (0, 0, 0, 0)
    assert not read.twist.covariance.any()


def test_the_first_sample_of_all_has_no_velocity():
    twist = decoded(MESSAGES["the first odometry"]).twist.twist
    assert (twist.linear.x, twist.angular.z) == (0.0, 0.0)


def test_a_command_keeps_its_velocity():
    read = decoded(MESSAGES["a command"])
    assert (read.header.frame_id, read.header.stamp.nanosec) == ("base", 500_000_000)
    assert (read.twist.linear.x, read.twist.angular.z) == (0.2, -0.7)


def test_frames_form_a_tree():
    outer, inner = decoded(MESSAGES["frames"]).transforms
    assert (outer.header.frame_id, outer.child_frame_id) == ("world", "odom")
    assert (inner.header.frame_id, inner.child_frame_id) == ("odom", "base")
    assert (outer.header.stamp.sec, inner.header.stamp.nanosec) == (1_000_000, 250_000_000)
    assert (outer.transform.translation.x, inner.transform.translation.y) == (1.0, -2.0)
    assert 2 * math.asin(outer.transform.rotation.z) == pytest.approx(3.0)
    assert 2 * math.asin(inner.transform.rotation.z) == pytest.approx(-0.5)


def test_a_line_keeps_ranges_and_codes():
    read, sent = decoded(MESSAGES["a line"]), line(3.000000001)
    assert (read.header.frame_id, read.header.stamp.nanosec) == ("laser", 1)
    assert np.array_equal(read.ranges, sent.ranges.astype(np.float32), equal_nan=True)
    assert np.array_equal(read.intensities, sent.codes)
    assert read.angle_max == np.float32(spec().elevations[-1])
    assert read.scan_time == np.float32(spec().line_period)


def test_bytes_keep_their_direction():
    read = decoded(MESSAGES["bytes"])
    assert (read.direction, read.data.tobytes()) == (">", b"\x80\x83\x01")


def test_a_record_keeps_its_text_and_bytes():
    read = decoded(MESSAGES["a record"])
    assert (read.kind, read.index, read.json) == ("views", 3, '{"a":[1]}')
    assert read.data.tobytes() == bytes(range(11))
    assert (read.stamp.sec, read.stamp.nanosec) == (2, 500_000_000)
