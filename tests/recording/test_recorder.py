import errno
import os
from itertools import count

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recorded import LINES, drive, line, make_robot, record
from rosbags.highlevel import AnyReader
from same import same

from scan3d_twin.api.run import open_recorder
from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.load import load_session, read_commands, read_lines
from scan3d_twin.recording.mcap import file as mcap_file
from scan3d_twin.recording.mcap.file import FLUSH_PERIOD
from scan3d_twin.recording.recorder import Recorder, SerialTaps

TOPICS = {
    "/cloud": "sensor_msgs/msg/PointCloud2",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/model": "sensor_msgs/msg/PointCloud2",
    "/odom": "nav_msgs/msg/Odometry",
    "/path": "nav_msgs/msg/Path",
    "/plan": "scan3d_twin_msgs/msg/Plan",
    "/registration": "scan3d_twin_msgs/msg/Registration",
    "/rosout": "rcl_interfaces/msg/Log",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/scan3d_twin/record": "scan3d_twin_msgs/msg/Record",
    "/serial/base": "scan3d_twin_msgs/msg/SerialBytes",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/viewpoint": "geometry_msgs/msg/PoseStamped",
    "/viewpoints": "visualization_msgs/msg/MarkerArray",
}


@pytest.fixture(scope="module")
def path(session, tmp_path_factory):
    """A finished session file, with a few raw bytes in it."""
    folder = tmp_path_factory.mktemp("run")
    recorder = Recorder(folder, lambda: 0.0, {"command": "twin"})
    recorder.on_bytes("/serial/base", 0.25, ">", b"\x80\x83")
    recorder.describe("boxes", load_session(record(folder / "other", session).path).settings)
    for _ in drive(recorder, recorder.attach(make_robot()), session):
        pass
    recorder.finish(session)
    return recorder.path


def test_a_finished_session_comes_back_bit_by_bit(path, session):
    recorded = load_session(path.parent)
    assert same(recorded.session, session)
    assert (recorded.path, recorded.finished, recorded.running) == (path, True, False)
    assert (recorded.name, recorded.settings.config) == ("boxes", session.config)
    assert recorded.mark.path == pytest.approx(0.6, abs=0.03)


def test_the_index_of_mcaps_own_reader_lists_everything(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        schemas = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        assert schemas == TOPICS
        read = [channel.topic for _, channel, _ in reader.iter_messages()]
        assert read.count("/scan") == 2 * LINES
        assert len(read) == summary.statistics.message_count
        (settings,) = (m for m in reader.iter_metadata() if m.name == "settings")
        assert settings.metadata["name"] == "boxes"


def test_mcap_ros2_support_reads_lines_and_clouds(path, session):
    read = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            read.setdefault(channel.topic, []).append(message)
    assert set(read) == set(TOPICS)
    scan = read["/scan"][0]
    assert scan.header.frame_id == "laser"
    assert np.isnan(scan.ranges[0])
    np.testing.assert_allclose(scan.ranges[1:], np.linspace(0.5, 4.0, 682)[1:], rtol=1e-6)
    assert list(scan.intensities[:2]) == [19, -1]
    assert scan.angle_min + 681 * scan.angle_increment == pytest.approx(scan.angle_max, abs=1e-4)
    cloud = read["/cloud"][1]
    columns = [
        np.ndarray(cloud.width, "<f4", bytes(cloud.data), field.offset, (cloud.point_step,))
        for field in cloud.fields[:3]
    ]
    view = session.views[1]
    placed = view.T_world_scan.apply(view.sweep.points)
    np.testing.assert_allclose(np.stack(columns, axis=1), placed, atol=1e-6)
    assert read["/plan"][0].reason == session.plans[0].reason
    assert read["/registration"][0].fitness == session.views[1].registration.fitness


def test_rosbags_reads_it_with_the_definitions_in_the_file(path):
    with AnyReader([path]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == TOPICS
        by_topic = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            by_topic.setdefault(connection.topic, []).append(message)
    assert by_topic["/serial/base"][0].data.tobytes() == b"\x80\x83"
    (mount,) = by_topic["/tf_static"][0].transforms
    assert (mount.header.frame_id, mount.child_frame_id) == ("base", "laser")
    assert mount.transform.translation.z == 0.30


def test_a_beam_up_in_the_lidar_is_a_beam_to_the_left_in_the_laser(path):
    """LaserScan's beams turn about z; the scan plane of the robot stands upright."""
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/tf_static"]
        ((_, _, data),) = reader.messages(wanted)
        q = reader.deserialize(data, wanted[0].msgtype).transforms[0].transform.rotation
    x, y, z, w = q.x, q.y, q.z, q.w
    laser_y_in_base = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    np.testing.assert_allclose(laser_y_in_base, [0, 0, 1], atol=1e-12)


def test_the_way_and_the_commands_are_complete(path):
    sent = list(read_commands(path))
    assert [stamp for stamp, _, _ in sent] == sorted(stamp for stamp, _, _ in sent)
    assert max(linear for _, linear, _ in sent) == Config().motion.speed
    assert sent[-1][1:] == (0.0, 0.0)
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/odom"]
        stamps = [stamp for _, stamp, _ in reader.messages(wanted)]
    np.testing.assert_allclose(np.diff(stamps), 15e6, atol=2)


def test_lines_come_back(path):
    read = list(read_lines(path))
    assert len(read) == 2 * LINES
    assert np.isnan(read[0].ranges[0])
    assert read[0].codes[0] == 19


def test_nothing_is_held_back_for_longer_than_the_flush_period(tmp_path):
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    robot = recorder.attach(make_robot())
    for k in range(40):
        robot.clock.sleep(0.1)
        recorder.on_line(line(robot.clock.now()))
        lost = k + 1 - len(list(read_lines(recorder.path.with_name("session.mcap.part"))))
        assert lost * 0.1 <= FLUSH_PERIOD + 0.1
    recorder.close()


def test_a_slow_robot_is_flushed_by_our_clock(tmp_path):
    ticks = count()
    recorder = Recorder(tmp_path, lambda: FLUSH_PERIOD * next(ticks), {})
    robot = recorder.attach(make_robot())
    recorder.on_line(line(robot.clock.now()))
    assert len(list(read_lines(recorder.path.with_name("session.mcap.part")))) == 1
    recorder.close()


def test_a_run_in_progress_can_be_looked_at_but_is_not_disturbed(tmp_path, session):
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    recorder.describe("boxes", load_session(record(tmp_path / "other", session).path).settings)
    for seen in drive(recorder, recorder.attach(make_robot()), session):
        recorded = load_session(tmp_path)
        assert same(recorded.session, seen)
        assert (recorded.finished, recorded.running) == (False, True)
    recorder.finish(session)
    assert load_session(tmp_path).finished


def test_only_one_run_records_in_a_folder(tmp_path, session):
    recorder = record(tmp_path, session, finish=False)
    with pytest.raises(FileError, match=r"cannot write .*session\.mcap\.part: File exists"):
        Recorder(tmp_path, lambda: 0.0, {})
    assert same(load_session(tmp_path).session.views, session.views)
    assert not recorder.path.exists()


class FullDisk:
    """``os.write`` on a disk with room for a limited number of bytes."""

    def __init__(self, room):
        self.room = room

    def __call__(self, fd, data):
        if self.room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = min(self.room, len(data))
        self.room -= taken
        return os.write(fd, data[:taken])


class Os:
    """The module ``os`` with another ``write``."""

    def __init__(self, write):
        self.write = write

    def __getattr__(self, name):
        return getattr(os, name)


@pytest.mark.parametrize("room", [10, 5_000, 20_000, 300_000, 600_000])
def test_a_full_disk_stops_the_robot_and_keeps_what_was_before(
    tmp_path, session, monkeypatch, room
):
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    recorder.describe("boxes", load_session(record(tmp_path / "other", session).path).settings)
    robot, seen = recorder.attach(make_robot()), [None]
    monkeypatch.setattr(mcap_file, "os", Os(FullDisk(room)))
    with pytest.raises(FileError, match=r"cannot record to .*No space left on device; earlier"):
        seen += drive(recorder, robot, session)
    assert robot.base._base.speed == (0.0, 0.0)
    monkeypatch.undo()
    with pytest.raises(FileError, match="No space left on device"):
        recorder.finish(session)
    recorder.close()
    assert not recorder.path.exists()
    if seen[-1] is not None:
        assert same(load_session(tmp_path).session, seen[-1])


def test_a_full_disk_before_the_first_view_does_not_promise_what_is_gone(tmp_path, monkeypatch):
    def run():
        with open_recorder(tmp_path) as recorder:
            robot = recorder.attach(make_robot())
            monkeypatch.setattr(mcap_file, "os", Os(FullDisk(0)))
            robot.clock.sleep(1.0)

    with pytest.raises(FileError, match="no view was finished, so nothing is kept: free disk"):
        run()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_never_keeps_a_byte_from_the_robot(tmp_path, monkeypatch):
    recorder = Recorder(tmp_path, lambda: 1e9, {})
    taps = SerialTaps()
    taps.base(0.0, ">", b"nobody listens yet")
    taps.listener = recorder.on_bytes
    monkeypatch.setattr(mcap_file, "os", Os(FullDisk(0)))
    for k in range(10):
        taps.lidar(float(k), ">", b"\x89\0\0\0\0")
    monkeypatch.undo()
    with pytest.raises(FileError, match="No space left"):
        recorder.attach(make_robot())
    recorder.close()
    taps.base(11.0, ">", b"stop")


def test_nothing_is_left_of_a_run_without_a_view(tmp_path, session):
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    recorder.attach(make_robot())
    recorder.abandon()
    assert not list(tmp_path.iterdir())


def test_a_view_is_left_of_a_run_that_broke_off(tmp_path, session):
    recorder = record(tmp_path, session, finish=False)
    recorder.abandon()
    assert len(load_session(tmp_path).session.views) == 2
