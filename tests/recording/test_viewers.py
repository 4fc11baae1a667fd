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

from scan3d_twin.recording.colours import view_colours_rgb

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
