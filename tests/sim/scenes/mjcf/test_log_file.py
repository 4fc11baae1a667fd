"""Scenes about which MuJoCo warns leave nothing in the working directory."""

import mujoco
import pytest

from scan3d_twin.sim.scenes.load import load_scene

CHILD = """<mujoco model="child"><worldbody>
  <body name="box"><geom type="box" size=".1 .1 .1"/></body>
</worldbody></mujoco>"""
PARENT = """<mujoco>
  <asset><model name="child" file="child.xml"/></asset>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="thing" pos="0 0 .1"><attach model="child" body="box" prefix=""/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def default_log(tmp_path, monkeypatch):
    """MuJoCo's own setting, as in a fresh process, in an empty working directory."""
    monkeypatch.chdir(tmp_path)
    before, config = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    config.logto_file, config.logfile = True, "MUJOCO_LOG.TXT"
    config.set()
    yield config
    before.set()


@pytest.fixture
def warning_scene(tmp_path):
    """An empty prefix: MuJoCo 4.0 reads it and warns."""
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/child.xml").write_text(CHILD)
    (tmp_path / "scene/parent.xml").write_text(PARENT)
    return "scene/parent.xml"


def test_a_scene_that_warns_leaves_no_log(default_log, warning_scene, tmp_path, capfd):
    load_scene(warning_scene, target="thing")

    assert "empty prefix" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_a_log_file_of_the_callers_own_stays(default_log, warning_scene, tmp_path):
    default_log.logfile = "mine.txt"
    default_log.set()

    load_scene(warning_scene, target="thing")

    assert "empty prefix" in (tmp_path / "mine.txt").read_text()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
