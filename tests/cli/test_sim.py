import json
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import trimesh
from scipy.spatial import cKDTree
from short_runs import COARSE, ONE_VIEW, TWO_VIEWS

from scan3d_twin.run.report import TIMING_FIELDS, report_schema
from scan3d_twin.sim.scenes.load import load_scene


def lasting(report):
    """Return ``report`` without what depends on the computer."""
    return {key: value for key, value in report.items() if key not in TIMING_FIELDS}


def test_a_run_leaves_its_files_and_nothing_else(finished):
    folder, _ = finished
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    files = {
        "model.ply",
        "report.json",
        "top_view.svg",
        "config.toml",
        "session.mcap",
        "report.html",
    }
    assert names == files | {"scene.png", "views/000.npz", "views/001.npz"}


def test_the_report_fits_its_schema(finished):
    jsonschema.validate(finished[1], report_schema())


def test_the_report_tells_of_this_run(finished):
    report = finished[1]
    assert (report["scene"], report["preset"], report["seed"]) == ("three_boxes", "best", 0)
    assert report["views"] == 2
    assert [row["view"] for row in report["registration"]] == [1]
    assert 0 < report["coverage_20mm"] <= 1
    assert report["path_m"] > 0.1
    assert report["turn_deg"] > 360
    assert report["real_time_factor"] > 0


def test_the_model_holds_the_points_of_all_views_in_the_world_but_outliers(finished):
    folder, report = finished
    cloud = trimesh.load(folder / "model.ply")
    view = np.ravel(cloud.metadata["_ply_raw"]["vertex"]["data"]["view"])
    assert len(cloud.vertices) == report["points"] > 1000
    assert set(view) == {0, 1}
    for index in (0, 1):
        with np.load(folder / "views" / f"{index:03d}.npz") as saved:
            x, y, yaw = saved["T_world_scan"]
            c, s = np.cos(yaw), np.sin(yaw)
            placed = saved["target_points"] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        kept = cloud.vertices[view == index]
        assert 0.97 * len(placed) < len(kept) <= len(placed)
        distance, _ = cKDTree(placed + np.array([x, y, 0])).query(kept)
        assert distance.max() < 1e-5


def test_the_saved_settings_are_the_effective_ones(finished):
    saved = tomllib.loads((finished[0] / "config.toml").read_text())
    assert saved["max_views"] == 2
    assert saved["run"]["scene"] == "three_boxes"
    assert saved["run"]["seed"] == 0
    assert saved["planning"]["lambda"] > 0


def test_the_saved_settings_give_the_same_bytes_again(finished, twin):
    folder, report = finished
    result = twin("sim", "--config", folder / "config.toml", "--out", "again", "--json")
    again = json.loads(result.out)
    assert result.code == 0
    assert lasting(again) == lasting(report)
    for name in ("model.ply", "config.toml", "top_view.svg", "views/000.npz", "views/001.npz"):
        assert (folder / name).read_bytes() == Path("again", name).read_bytes(), name


def test_json_is_one_document_and_equals_the_file_and_another_seed_gives_another_model(
    finished, twin
):
    result = twin(*TWO_VIEWS, "--json", "--seed", "1", "--out", "run")
    assert result.code == 0
    assert result.out == Path("run/report.json").read_text()
    jsonschema.validate(json.loads(result.out), report_schema())
    assert "view 0" in result.err
    assert (finished[0] / "model.ply").read_bytes() != Path("run/model.ply").read_bytes()


def test_the_default_folder_is_named_after_the_scene(twin, tmp_path):
    result = twin(*ONE_VIEW)
    assert result.code == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.startswith("three_boxes-20")
    assert f"runs/{folder.name}: model.ply report.html" in result.out


def test_a_mesh_file_is_a_scene(twin, tmp_path):
    trimesh.creation.box((300, 300, 500)).export(tmp_path / "crate.stl")
    result = twin(
        "sim", "--scene", "crate.stl", "--mesh-scale", "0.001", "--max-views", "2", "--json",
        *COARSE,
    )  # fmt: skip
    assert result.code in (0, 4)
    assert json.loads(result.out)["scene"] == "crate"
    (folder,) = (tmp_path / "runs").iterdir()
    saved = tomllib.loads((folder / "config.toml").read_text())["run"]
    assert saved["scene"] == str(tmp_path / "crate.stl")
    assert saved["mesh_scale"] == 0.001


def test_what_was_repaired_is_said_at_once_and_in_the_report(twin, tmp_path):
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    box.invert()
    box.export(tmp_path / "crate.stl")
    result = twin("sim", "--scene", "crate.stl", "--max-views", "1", "--json", *COARSE)
    note = "Mesh target: 12 of 12 faces are wound inwards and were turned."
    size, said, *_ = result.err.splitlines()
    assert size.startswith(
        "mesh crate.stl, 0.30 x 0.40 x 0.50 m high, in a room of 5 x 5 m; --mesh-up"
    )
    assert said == note
    assert json.loads(result.out)["warnings"][0] == note


def test_a_target_that_was_not_scanned_is_told(twin, tmp_path):
    (tmp_path / "hidden.xml").write_text(
        '<mujoco><worldbody><site name="spawn"/>'
        '<geom type="box" size=".2 .6 .5" pos="1.7 0 .5"/>'
        '<geom name="target" type="box" size=".1 .1 .1" pos="3.2 0 .1"/></worldbody></mujoco>'
    )
    result = twin("sim", "--scene", "hidden.xml", "--max-views", "1", "--json", *COARSE)
    report = json.loads(result.out)
    assert report["coverage_20mm"] is None
    assert "What was scanned is not a target of this scene (target)" in report["warnings"][0]


def test_a_target_can_be_named_or_placed(twin):
    name = next(iter(load_scene("three_boxes").targets))
    assert twin(*ONE_VIEW, "--target", name, "--out", "named").code == 0
    assert twin(*ONE_VIEW, "--target", "1.6,-0.6", "--out", "placed").code == 0
