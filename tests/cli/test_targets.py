import json
import tomllib

import pytest
from short_runs import COARSE
from two_targets import TWO


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(TWO)
    return path


def test_each_target_is_a_run_in_a_folder_of_its_own(twin, fails, scene, tmp_path):
    out = tmp_path / "both"
    given = ("--targets", 3, "--max-views", 2, "--out", out, "--json", *COARSE)
    told = twin("sim", "--scene", scene, *given)
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
