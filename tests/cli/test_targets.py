import json
import tomllib

import pytest

TWO = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 0.1"/>
  <geom name="north" type="box" pos="0 2.4 1" size="3 0.05 1"/>
  <geom name="south" type="box" pos="0 -2.4 1" size="3 0.05 1"/>
  <geom name="east" type="box" pos="3 0 1" size="0.05 2.4 1"/>
  <geom name="west" type="box" pos="-2 0 1" size="0.05 2.4 1"/>
  <body name="target_a" pos="1.5 0.9 0.3"><geom type="box" size="0.2 0.3 0.3"/></body>
  <body name="target_b" pos="1.5 -0.8 0.2"><geom type="box" size="0.15 0.2 0.2"/></body>
  <site name="spawn" pos="0 0 0"/>
</worldbody></mujoco>
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(TWO)
    return path


def test_each_target_is_a_run_in_a_folder_of_its_own(twin, fails, scene, tmp_path):
    out = tmp_path / "both"
    told = twin("sim", "--scene", scene, "--targets", 3, "--max-views", 2, "--out", out, "--json")
    assert told.code == 0
    assert "found 2 of 3 targets" in told.err
    reports = json.loads(told.out)["targets"]
    assert [report["views"] for report in reports] == [2, 2]
    assert all(report["path_m"] < 5.0 for report in reports)
    index = json.loads((out / "targets.json").read_text())
    assert [each["folder"] for each in index] == ["target-0", "target-1"]
    assert index[0]["place_m"][1] > 0.3 > -0.3 > index[1]["place_m"][1]
    for each, report in zip(index, reports, strict=True):
        own = out / each["folder"]
        assert json.loads((own / "report.json").read_text()) == report
        run = tomllib.loads((own / "config.toml").read_text())["run"]
        assert [float(part) for part in run["target"].split(",")] == each["place_m"]
        assert {"session.mcap", "report.html", "model.ply"} <= {p.name for p in own.iterdir()}
    for folder in (out, out / "target-1"):
        assert "--targets" in fails(2, "sim", "--resume", folder)


def test_what_says_otherwise_what_to_scan_is_refused(fails, scene, tmp_path):
    sim = ("sim", "--scene", scene, "--out", tmp_path / "none")
    assert "give one" in fails(2, *sim, "--targets", 2, "--target", "1,0")
    assert "at least 1" in fails(2, *sim, "--targets", 0)
    assert not (tmp_path / "none").exists()
