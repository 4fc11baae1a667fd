"""What viewers draw of a recording is what the session holds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recorded import record
from sessions import two_planned_views

from scan3d_twin.core.types import Candidate, Plan, Pose2
from scan3d_twin.recording.colours import GREY, pack_rgb, view_colours_rgb
from scan3d_twin.recording.mcap import ros_display
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.ros_display import INFEASIBLE_COLOUR, MODEL_VOXEL, PATH_STEP
from scan3d_twin.recording.repair.edit import drop_view

KINDS = {7: "<f4", 4: "<u2", 2: "u1"}
"""NumPy's names of the data types of ``sensor_msgs/PointField``."""


@pytest.fixture(scope="module")
def session():
    """Two views, each with a plan."""
    return two_planned_views()


def read(path):
    """Return all messages by topic, as mcap-ros2-support decodes them."""
    found = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    return found


@pytest.fixture(scope="module")
def messages(session, tmp_path_factory):
    return read(record(tmp_path_factory.mktemp("run"), session).path)


def points_of(cloud):
    """Return the points by the fields that the message states."""
    layout = {
        "names": [field.name for field in cloud.fields],
        "formats": [KINDS[field.datatype] for field in cloud.fields],
        "offsets": [field.offset for field in cloud.fields],
        "itemsize": cloud.point_step,
    }
    return np.frombuffer(bytes(cloud.data), np.dtype(layout), cloud.width)


def colours_of(points):
    """Return red, green and blue as PCL takes them from the bits of a float."""
    bits = points["rgb"].copy().view(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1)


def test_a_view_is_in_its_colour_where_it_shows_the_target_and_grey_elsewhere(messages, session):
    for index, cloud in enumerate(messages["/cloud"]):
        points = points_of(cloud)
        is_target = points["target"] == 1
        assert np.count_nonzero(is_target) == len(session.views[index].target)
        assert not is_target.all()
        colours = colours_of(points)
        assert np.array_equal(np.unique(colours[~is_target], axis=0), [GREY])
        (own,) = np.unique(colours[is_target], axis=0)
        assert np.array_equal(own, view_colours_rgb(np.array([index]))[0])


def test_the_model_grows_view_by_view(messages, session):
    first, second, at_the_end = (points_of(cloud) for cloud in messages["/model"])
    assert set(first["view"]) == {0}
    assert set(second["view"]) == {0, 1}
    assert np.array_equal(at_the_end, second)
    assert np.array_equal(colours_of(second), view_colours_rgb(second["view"].astype(np.int64)))


def test_the_model_has_a_point_in_each_cube_and_no_two(messages, session):
    points = points_of(messages["/model"][-1])
    placed = np.stack([points[axis] for axis in "xyz"], axis=1)
    seen = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
    cubes = {tuple(cube) for cube in np.floor(seen / MODEL_VOXEL).astype(int)}
    assert len(points) == len(cubes)
    distance = np.abs(seen[:, None, :] - placed[None, :200, :]).max(axis=2).min(axis=0)
    assert distance.max() < 1e-6


def test_a_model_without_points_is_a_cloud_without_points(session):
    message = ros_display.encode_model(0.0, replace(session, views=(), plans=()))
    assert ros.typestore().deserialize_cdr(message.data, message.kind).width == 0


def test_the_path_follows_the_robot_and_only_grows(messages):
    before = []
    for path in messages["/path"]:
        assert path.header.frame_id == "world"
        places = [(p.pose.position.x, p.pose.position.y) for p in path.poses]
        stamps = [p.header.stamp.sec + p.header.stamp.nanosec / 1e9 for p in path.poses]
        assert places[: len(before)] == before
        assert stamps == sorted(stamps)
        before = places
    steps = np.linalg.norm(np.diff(before, axis=0), axis=1)
    assert steps.min() >= PATH_STEP
    assert len(before) > 6
    odometry = messages["/odom"][-1].pose.pose.position
    frames = {t.child_frame_id: t.transform for t in messages["/tf"][-1].transforms}
    turn, shift = frames["odom"].rotation, frames["odom"].translation
    yaw = 2 * math.atan2(turn.z, turn.w)
    end = Pose2(shift.x, shift.y, yaw) @ Pose2(odometry.x, odometry.y, 0.0)
    assert math.dist(before[-1], (end.x, end.y)) < PATH_STEP + 0.01


def markers_of(message, namespace):
    return [marker for marker in message.markers if marker.ns == namespace]


def pose_of(marker):
    pose = marker.pose
    yaw = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    return Pose2(pose.position.x, pose.position.y, yaw)


def test_viewpoints_are_numbered_arrows_and_the_next_one_is_told_apart(messages, session):
    last = messages["/viewpoints"][-1]
    assert last.markers[0].action == 3  # DELETEALL: nothing stays of a view that was dropped
    arrows, numbers = markers_of(last, "views"), markers_of(last, "numbers")
    assert [number.text for number in numbers] == ["0", "1"]
    for index, (arrow, view) in enumerate(zip(arrows, session.views, strict=True)):
        assert pose_of(arrow).distance(view.T_world_scan) < 1e-9
        colour = [arrow.color.r, arrow.color.g, arrow.color.b]
        expected = view_colours_rgb(np.array([index]))[0] / 255
        np.testing.assert_allclose(colour, expected, atol=1e-6)
    (chosen,) = markers_of(last, "next")
    assert pose_of(chosen).distance(session.plans[-1].viewpoint) < 1e-9
    assert {marker.header.frame_id for marker in last.markers} == {"world"}


def test_candidates_show_which_ones_the_robot_can_reach(session):
    candidates = tuple(
        Candidate(Pose2(float(k), 0.5, 0.0), 0.5, 0.004, feasible=k != 1) for k in range(3)
    )
    plan = Plan(None, 0.0, math.nan, False, candidates, "done")
    message = ros_display.encode_viewpoints(1.0, session.with_plan(plan))
    decoded = ros.typestore().deserialize_cdr(message.data, message.kind)
    dots = markers_of(decoded, "candidates")
    assert [dot.pose.position.x for dot in dots] == [0.0, 1.0, 2.0]
    reds = [round(255 * dot.color.r) for dot in dots]
    assert reds == [GREY[0], INFEASIBLE_COLOUR[0], GREY[0]]
    assert markers_of(decoded, "next") == []


def test_a_dropped_view_leaves_the_model_and_the_markers(session, tmp_path):
    record(tmp_path, session)
    drop_view(tmp_path, 1, lambda: 0.0)
    after = read(tmp_path / "session.mcap")
    assert set(points_of(after["/model"][-1])["view"]) == {0}
    assert [marker.text for marker in markers_of(after["/viewpoints"][-1], "numbers")] == ["0"]


def test_colours_survive_the_bits_of_a_float():
    colours = np.random.default_rng(0).integers(0, 256, (1000, 3)).astype(np.uint8)
    packed = pack_rgb(colours)
    assert packed.dtype == np.float32
    bits = packed.view(np.uint32)
    assert np.array_equal(np.stack([bits >> 16, bits >> 8 & 255, bits & 255], axis=1), colours)
