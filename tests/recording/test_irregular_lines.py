"""Sessions of lines that have elevations of their own, and files from before there were any."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recorded import drive, line, make_robot, record
from same import same
from sessions import session_at
from synthetic import THREE_BOXES, irregular, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.types import Observation, Plan, Pose2, RangeImage
from scan3d_twin.recording.exact_json import pack, unpack
from scan3d_twin.recording.image import image_bytes
from scan3d_twin.recording.load import load_session, read_lines
from scan3d_twin.recording.recorder import Recorder
from scan3d_twin.recording.scans import read_image

PLAN = Plan(None, 0.0, float("nan"), False, (), "enough")


@pytest.fixture(scope="module")
def image():
    rng = np.random.default_rng(2)
    return observe(Pose2(), THREE_BOXES, room=False, sigma=0.004, rng=rng, shift=irregular).image


@pytest.fixture(scope="module")
def session(image):
    """A session of one regular view and one of lines with elevations of their own."""
    session = session_at(THREE_BOXES)
    session = integrate(session.with_plan(PLAN), Observation(image, Pose2(0.0, 0.02)))
    return session.with_plan(PLAN)


def test_a_session_comes_back_bit_by_bit(session, image, tmp_path):
    recorded = load_session(record(tmp_path, session).path)
    assert same(recorded.session, session)
    found = recorded.session.views[1].observation.image
    assert np.array_equal(found.elevations, image.elevations)
    assert np.array_equal(found.points, image.points, equal_nan=True)
    assert recorded.session.views[0].observation.image.elevations is None


def test_compressing_a_view_keeps_its_elevations(session):
    view = session.views[1]
    again = unpack(RangeImage, pack(view.image))
    points = again.points
    again.compress()
    assert np.array_equal(again.points, points, equal_nan=True)
    assert np.array_equal(again.elevations, view.image.elevations)


def test_the_target_lies_where_the_beams_are(session):
    view = session.views[1]
    assert len(view.target) > 5000
    assert np.array_equal(
        view.target.points, view.image.points_at(view.target.lines, view.target.beams)
    )
    off = view.target.points[:, 2] - 0.3
    forward = np.hypot(*view.target.points[:, :2].T) - 0.05
    own = view.image.elevations[view.target.lines, view.target.beams]
    assert np.arctan2(off, forward) == pytest.approx(own, abs=1e-6)


def test_an_image_of_an_older_file_has_the_elevations_of_its_lidar():
    regular = observe(Pose2()).image
    text, blob = pack(regular)
    older = json.loads(text)
    assert older.pop("elevations") is None
    again = unpack(RangeImage, (json.dumps(older), blob))
    assert again.elevations is None
    assert np.array_equal(again.points, regular.points, equal_nan=True)


def test_an_npz_holds_the_elevations_only_if_lines_have_their_own(image, tmp_path):
    for each in (image, observe(Pose2()).image):
        data = image_bytes(Observation(each, Pose2()))
        (tmp_path / "scan.npz").write_bytes(data)
        found = read_image(tmp_path / "scan.npz")
        assert np.array_equal(found.points, each.points, equal_nan=True)
        with np.load(io.BytesIO(data)) as arrays:
            assert ("line_elevations" in arrays) == (each.elevations is not None)
            assert arrays["elevations"].shape == (each.spec.n_beams,)


def test_the_angles_of_lines_are_recorded(session, tmp_path):
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    recorder.describe("boxes", load_session(record(tmp_path / "other", session).path).settings)
    robot = recorder.attach(make_robot())
    spec = robot.lidar.spec
    own = replace(line(0.5), elevations=spec.elevations + 0.001, beam_times=spec.beam_times * 1.03)
    for each in (line(0.4), own, line(0.6), replace(own, stamp=0.7, beam_times=None)):
        recorder.on_line(each)
    for _ in drive(recorder, robot, session):
        pass
    recorder.finish(session)

    # Read back by the program
    read = list(read_lines(recorder.path))[:4]
    assert [each.stamp for each in read] == pytest.approx([0.4, 0.5, 0.6, 0.7])
    assert [each.elevations is None for each in read] == [True, False, True, False]
    assert np.array_equal(read[1].elevations, own.elevations)
    assert np.array_equal(read[1].beam_times, own.beam_times)
    assert np.array_equal(read[3].beam_times, spec.beam_times)

    # Read by ROS tools
    with recorder.path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        told = [m for _, c, _, m in reader.iter_decoded_messages() if c.topic == "/scan/angles"]
    assert len(told) == 2
    assert told[0].header.frame_id == "laser"
    assert list(told[0].elevations) == own.elevations.tolist()
