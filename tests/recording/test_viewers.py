"""A recording in rerun's importer and in Foxglove's own libraries, where they are installed."""

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from recorded import LINES, record

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export import find_format
from scan3d_twin.recording.mcap.ros_display import PATH_STEP

ROOT = Path(__file__).resolve().parents[2]
NODE_MODULES = os.environ.get("SCAN3D_TWIN_NODE_MODULES", str(ROOT / "build/node/node_modules"))
"""Where `@mcap/core` and the rest are, which .ci/run installs."""
LAYOUT = ROOT / "docs" / "_static" / "foxglove_layout.json"
DRAWN_BY_RERUN = {
    "/cloud": "Points3D:positions",
    "/model": "Points3D:positions",
    "/rosout": "TextLog:text",
    "/tf": "Transform3D:translation",
    "/tf_static": "Transform3D:translation",
    "/viewpoint": "InstancePoses3D:translations",
}
"""Topics that rerun 0.41 draws of its own accord, and a component of each."""


@pytest.fixture(scope="module")
def path(session, tmp_path_factory):
    """A finished session file."""
    return record(tmp_path_factory.mktemp("run"), session).path


def test_rerun_draws_what_it_has_types_for(path, session):
    """As ``rerun mcap convert``; it takes no colour from a cloud, in whatever form."""
    chunks = pytest.importorskip("rerun.chunk", exc_type=ImportError)
    columns, points = {}, {}
    for chunk in chunks.McapReader(path).stream():
        batch = chunk.to_record_batch()
        columns.setdefault(str(chunk.entity_path), set()).update(batch.schema.names)
        if "Points3D:positions" in batch.schema.names:
            rows = batch.column("Points3D:positions").to_pylist()
            points.setdefault(str(chunk.entity_path), []).extend(rows)
    drawn = ("Points3D", "TextLog", "Transform3D", "InstancePoses3D", "Scalars", "LineStrips3D")
    assert {
        topic for topic, names in columns.items() if any(n.startswith(drawn) for n in names)
    } == {*DRAWN_BY_RERUN}
    for topic, component in DRAWN_BY_RERUN.items():
        assert component in columns[topic]
    for view, cloud in zip(session.views, points["/cloud"], strict=True):
        placed = view.T_world_scan.apply(view.sweep.points)
        np.testing.assert_allclose(np.array(cloud), placed, atol=1e-6)


@pytest.fixture(scope="module")
def in_rerun(path, tmp_path_factory):
    """What ``--to rrd`` writes, as rerun reads it: rows of each component by entity, in order."""
    chunks = pytest.importorskip("rerun.chunk", exc_type=ImportError)
    written = tmp_path_factory.mktemp("rrd") / "session.rrd"
    find_format("rrd").write(path, written)
    found = {}
    for chunk in chunks.RrdReader(written).stream():
        batch = chunk.to_record_batch()
        columns = found.setdefault(str(chunk.entity_path).lstrip("/"), {})
        for name in batch.schema.names:
            columns.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


def test_an_rrd_has_each_view_in_its_colour_at_its_final_pose(in_rerun, session):
    for index, view in enumerate(session.views):
        model = in_rerun[f"world/model/{index:03d}"]
        (points,) = model["Points3D:positions"]
        placed = view.T_world_scan.apply(view.target.points)
        np.testing.assert_allclose(points, placed, atol=1e-6)
        (rest,) = in_rerun[f"world/surroundings/{index:03d}"]["Points3D:positions"]
        assert len(rest) == len(view.sweep) - len(view.target)
        ((packed,),) = model["Points3D:colors"]
        red, green, blue = view_colours_rgb(np.array([index]))[0].tolist()
        assert packed == red << 24 | green << 16 | blue << 8 | 255
        (stamp,) = model["robot_time"]
        assert stamp.total_seconds() == pytest.approx(view.image.stamps.max(), abs=1e-6)


def test_an_rrd_has_the_drive_the_lines_and_the_decisions(in_rerun, session):
    assert len(in_rerun["world/scan"]["Points3D:positions"]) == 2 * LINES
    (strip,) = in_rerun["world/path"]["LineStrips3D:strips"][-1]
    steps = np.linalg.norm(np.diff(np.array(strip), axis=0), axis=1)
    assert len(strip) > 6
    assert steps.min() >= PATH_STEP - 1e-6
    events = [text for (text,) in in_rerun["events"]["TextLog:text"]]
    assert f"plan: {session.plans[-1].reason}" in events
    assert f"end: {session.stop_reason}" in events
    ((origin,),) = in_rerun["world/plan/next"]["Arrows3D:origins"][-1:] or [[None]]
    where = session.plans[-1].viewpoint
    np.testing.assert_allclose(origin[:2], [where.x, where.y], atol=1e-6)


def test_a_scan_line_of_an_rrd_lies_where_the_lidar_saw_it(in_rerun):
    """The lidar stands 0.30 m high; the readings of ``recorded.line`` grow from 0.5 to 4 m."""
    line = np.array(in_rerun["world/scan"]["Points3D:positions"][0])
    assert len(line) == 681  # the first reading is an error
    robot = np.array(in_rerun["world/robot"]["Arrows3D:origins"][0][0])
    distances = np.hypot(np.hypot(*(line[:, :2] - robot[:2]).T), line[:, 2] - 0.30)
    assert 0.4 < distances.min() < 0.7
    assert 3.7 < distances.max() < 4.3
    assert np.ptp(line[:, 2]) > 3.0  # its plane stands upright


def test_an_rrd_that_cannot_be_written_leaves_nothing(path, tmp_path):
    pytest.importorskip("rerun", exc_type=ImportError)
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write"):
        find_format("rrd").write(path, tmp_path / "file" / "x.rrd")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


@pytest.fixture(scope="module")
def in_foxglove(path):
    """What Foxglove's reader and decoder find in the file: type, count, last message by topic."""
    node = shutil.which("node")
    if node is None or not (Path(NODE_MODULES) / "@mcap/core").is_dir():
        pytest.skip("needs node and: npm install --prefix build/node @mcap/core @mcap/nodejs ...")
    script = Path(__file__).with_name("read_with_foxglove.cjs")
    environment = {**os.environ, "NODE_PATH": NODE_MODULES}
    done = subprocess.run(
        [node, script, path], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_foxglove_decodes_every_message(in_foxglove, session):
    assert in_foxglove["/scan"]["count"] == 2 * LINES
    assert in_foxglove["/plan"]["last"]["reason"] == session.plans[-1].reason
    assert len(in_foxglove["/path"]["last"]["poses"]) > 6
    numbers = [each["text"] for each in in_foxglove["/viewpoints"]["last"]["markers"]]
    assert [text for text in numbers if text] == ["0", "1"]


def test_foxglove_gets_the_model_in_the_colours_of_the_views(in_foxglove):
    cloud = in_foxglove["/model"]["last"]
    offsets = {field["name"]: field["offset"] for field in cloud["fields"]}
    rows = np.frombuffer(base64.b64decode(cloud["data"]), np.uint8).reshape(cloud["width"], -1)
    assert rows.shape[1] == cloud["point_step"]
    # Foxglove's colour mode "rgb" takes the bytes of the field rgb as blue, green, red
    rgb = rows[:, offsets["rgb"] : offsets["rgb"] + 3][:, ::-1]
    view = rows[:, offsets["view"] : offsets["view"] + 2].copy().view("<u2")[:, 0]
    assert set(view) == {0, 1}
    np.testing.assert_array_equal(rgb, view_colours_rgb(view.astype(np.int64)))


def panel(name):
    return json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"][name]


def test_the_layout_shows_topics_that_a_recording_has(path):
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        topics = {c.topic for c in make_reader(stream).get_summary().channels.values()}
    shown = {*panel("3D!run")["topics"], panel("RawMessages!plan")["topicPath"]}
    shown |= {each["value"].split(".")[0] for each in panel("Plot!errors")["paths"]}
    shown.add(panel("RosOut!events")["topicToRender"])
    assert shown <= topics
    assert {"/model", "/path", "/scan", "/viewpoints", "/plan"} <= shown


def test_every_panel_of_the_layout_is_laid_out():
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))

    def panels(node):
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


def test_the_settings_of_the_layout_are_those_that_foxglove_knows():
    layouts = pytest.importorskip("foxglove.layouts", exc_type=ImportError)
    config = panel("3D!run")
    # Left out: what the SDK does not write, but the app exports with each layout
    known = {*layouts.ThreeDeeConfig()._to_dict(), "followTf", "publish"}
    assert set(config) <= known
    kinds = {
        "/model": layouts.BaseRendererPointCloudTopicSettings,
        "/cloud": layouts.BaseRendererPointCloudTopicSettings,
        "/scan": layouts.BaseRendererLaserScanTopicSettings,
        "/path": layouts.BaseRendererPosesTopicSettings,
        "/odom": layouts.BaseRendererPoseTopicSettings,
        "/viewpoint": layouts.BaseRendererPoseTopicSettings,
        "/viewpoints": layouts.BaseRendererRosMarkerTopicSettings,
    }
    assert set(kinds) == set(config["topics"])
    for topic, kind in kinds.items():
        assert set(config["topics"][topic]) <= set(kind()._to_dict())
