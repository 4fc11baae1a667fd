import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rosbags.highlevel import AnyReader

from scan3d_twin.recording.load import load_session


def test_a_finished_run_is_exported_into_its_folder(finished, twin):
    folder, report = finished
    result = twin("export", folder, "--to", "ply")
    assert result.code == 0
    assert result.out.split() == [str(folder / "cloud.ply")]
    assert 0.9 * report["points"] < len(trimesh.load(folder / "cloud.ply").vertices)
    (folder / "cloud.ply").unlink()


def test_the_command_that_the_report_names_writes_what_it_says(
    finished, twin, tmp_path, monkeypatch
):
    pytest.importorskip("pye57")
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    page = (run / "report.html").read_text(encoding="utf-8")
    (command,) = re.findall(r"<code>twin ([^<]* --to e57)</code>", page)
    monkeypatch.chdir(run)
    assert twin(*command.split()).code == 0
    assert (run / "cloud.e57").read_bytes()[:8] == b"ASTM-E57"


def test_views_apart_and_fused_ones_go_where_they_are_sent(finished, twin):
    folder, report = finished
    done = twin("export", folder, "--to", "xyz", "--per-view", "--out", "apart", "--json")
    files = json.loads(done.out)["files"]
    assert files == ["apart/view_000.xyz", "apart/view_001.xyz", "apart/poses.csv"]
    assert twin("export", folder, "--to", "xyz", "--voxel", "20", "--out", "few.xyz").code == 0
    assert 100 < len(np.loadtxt("few.xyz")) < report["points"] / 3


@pytest.mark.parametrize(
    ("options", "name"),
    [(("--to", "xyz", "--per-view"), "xyz_views"), (("--to", "uos"), "uos")],
    ids=["views", "uos"],
)
def test_a_link_in_the_folder_of_a_run_leads_no_files_elsewhere(
    finished, twin, fails, tmp_path, options, name
):
    folder, _ = finished
    run, mine = tmp_path / "run", tmp_path / "mine"
    run.mkdir()
    mine.mkdir()
    shutil.copy(folder / "session.mcap", run)
    (run / name).symlink_to(mine)
    assert "is a link to another place" in fails(3, "export", run, *options)
    assert not list(mine.iterdir())
    assert twin("export", run, *options, "--out", run / name).code == 0
    assert list(mine.iterdir())


def test_a_rosbag2_holds_all_that_was_recorded(finished, twin):
    folder, _ = finished
    assert twin("export", folder, "--to", "rosbag2", "--out", "bag").code == 0
    assert (Path("bag") / "bag.mcap").is_file()
    with AnyReader([Path("bag")]) as reader:
        topics = {each.topic: each for each in reader.connections}
        assert topics["/scan"].msgtype == "sensor_msgs/msg/LaserScan"
        scans = sum(1 for _ in reader.messages([topics["/scan"]]))
        assert scans >= sum(v.observation.image.n_lines for v in load_session(folder).session.views)
        static = topics["/tf_static"].ext.offered_qos_profiles
        assert static[0].durability.name == "TRANSIENT_LOCAL"
    again = twin("export", folder, "--to", "rosbag2", "--out", "bag")
    assert (again.code, "exists" in again.err) == (3, True)


@pytest.mark.parametrize("command", [("mesh",), ("export",)])
def test_a_mesh_is_written_by_either_command(command, finished, twin):
    folder, _ = finished
    result = twin(*command, folder, "--to", "stl", "--out", "mesh.stl", "--json")
    told = json.loads(result.out)
    assert told["triangles"] == len(trimesh.load("mesh.stl").faces) > 5000
    assert told["area_m2"] == pytest.approx(trimesh.load("mesh.stl").area, rel=1e-3)


@pytest.mark.parametrize("command", [("mesh",), ("export",)])
def test_a_mesh_for_a_printer_is_in_millimetres(command, finished, twin):
    folder, _ = finished
    told = [
        json.loads(
            twin(*command, folder, "--to", "stl", "--unit", unit, "--out", unit, "--json").out
        )
        for unit in ("m", "mm")
    ]
    assert [each["unit"] for each in told] == ["m", "mm"]
    assert told[0]["area_m2"] == told[1]["area_m2"]
    metres, millimetres = (trimesh.load(unit, file_type="stl") for unit in ("m", "mm"))
    np.testing.assert_allclose(millimetres.bounds, 1000 * metres.bounds, rtol=1e-6)


def test_views_in_millimetres_have_their_places_in_millimetres(finished, twin):
    folder, _ = finished
    for unit in ("m", "mm"):
        done = twin(
            "export", folder, "--to", "xyz", "--per-view", "--unit", unit, "--out", unit, "--json"
        )
        assert json.loads(done.out)["unit"] == unit
    metres, millimetres = (np.loadtxt(Path(unit) / "view_001.xyz") for unit in ("m", "mm"))
    np.testing.assert_allclose(millimetres, 1000 * metres, atol=0.051)
    heads, rows = zip(
        *((Path(unit) / "poses.csv").read_text().splitlines()[::2] for unit in ("m", "mm")),
        strict=True,
    )
    assert heads == ("name,x_m,y_m,yaw_rad", "name,x_mm,y_mm,yaw_rad")
    x, y, yaw = (np.array([float(row.split(",")[k]) for row in rows]) for k in (1, 2, 3))
    np.testing.assert_allclose([x[1], y[1]], [1000 * x[0], 1000 * y[0]], atol=1e-3)
    assert yaw[0] == yaw[1] != 0


def test_the_mesh_was_measured_when_the_truth_was_known(finished):
    accuracy = finished[1]["mesh_accuracy_mm"]
    assert 0 < accuracy["median"] < accuracy["p95"] < 200


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("export", "RUN", "--to", "dxf"), 2, "known: e57"),
        (("export", "RUN", "--to", "stl", "--per-view"), 2, "are for point clouds"),
        (("export", "RUN", "--to", "ply", "--voxel", "-1"), 2, "--voxel must be"),
        (("export", "RUN", "--to", "uos", "--unit", "mm"), 2, "uos files are in centimetres"),
        (("export", "RUN", "--to", "rosbag2", "--unit", "mm"), 2, "rosbag2 files are in metres"),
        (("export", "RUN", "--to", "glb", "--unit", "mm"), 2, "glb files are in metres"),
        (("mesh", "RUN", "--to", "glb", "--unit", "mm"), 2, "glb files are in metres"),
        (("export", "nowhere", "--to", "ply"), 3, "no session in nowhere"),
        (("mesh", "nowhere"), 3, "no session in nowhere"),
        (("mesh", "RUN", "--to", "las"), 2, "no format of meshes"),
    ],
)
def test_mistakes_are_told_in_a_line(arguments, code, words, finished, twin):
    result = twin(*(finished[0] if each == "RUN" else each for each in arguments))
    assert (result.code, result.err.count("\n")) == (code, 1)
    assert words in result.err
