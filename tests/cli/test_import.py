"""``twin import``: sweeps of other scanners become runs that all other commands read."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import other_scanners
import pytest
import synthetic

from scan3d_twin.core.types import Pose2, RangeImage
from scan3d_twin.recording.load import load_session
from scan3d_twin.run.report import report_schema
from scan3d_twin.viz.film import prepare_film

PLACES = (Pose2(-0.4, 0.1, 0.1), Pose2(0.1, -0.4, 0.7), Pose2(-0.8, 0.3, -0.2))
ELSEWHERE = (synthetic.Box((0.5, -3.0, 0.0), (0.6, 3.0, 1.0)),)
OPTION, FILE, FAILED = 2, 3, 4


@cache
def sweep(k: int) -> RangeImage:
    """Return the sweep from place ``k``; the last one shows another place."""
    lidar = synthetic.spec(121)
    lidar = replace(lidar, elevations=3.5 * lidar.elevations)
    place, boxes = (PLACES[k], synthetic.THREE_BOXES) if k < len(PLACES) else (Pose2(), ELSEWHERE)
    return synthetic.observe(
        place, boxes, width=math.radians(200), step=math.radians(2.0), sigma=0.005,
        rng=np.random.default_rng(k), lidar=lidar, room=k < len(PLACES),
    ).image  # fmt: skip


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The sweeps of all places, one CSV file each."""
    folder = tmp_path_factory.mktemp("scans") / "hall"
    folder.mkdir()
    for k in range(len(PLACES)):
        other_scanners.write_readings(folder / f"scan{k}.csv", sweep(k))
    return folder


def test_the_sweeps_of_a_folder_become_one_model(twin, folder):
    result = twin("import", folder, "--out", "run", "--json")
    assert result.code == 0
    report = json.loads(result.out)
    jsonschema.validate(report, report_schema())
    assert report == json.loads(Path("run/report.json").read_text())
    assert report["views"] == 3
    assert report["warnings"] == []
    assert "0.30 m above the floor" in result.err

    # The views are where they were taken, and say how well they are
    session = load_session(Path("run")).session
    for view, place in zip(session.views, PLACES, strict=True):
        assert view.T_world_scan.distance(PLACES[0].inverse() @ place) < 0.01
    assert all(0 < row["predicted_rmse_mm"] < 10 for row in report["registration"])
    assert all(row["correction_mm"] is None for row in report["registration"])

    # All other commands read it
    assert "3 views" in twin("session", "info", "run").out
    assert twin("export", "run", "--to", "xyz").code == 0
    assert twin("mesh", "run").code == 0
    assert twin("compare", "run", "run").code == 0
    assert "identical" in twin("replay", "run").out
    film = prepare_film(load_session(Path("run")))
    assert film.track[:, 1:3] == pytest.approx(
        np.array([(v.T_world_scan.x, v.T_world_scan.y) for v in session.views])
    )
    assert twin("session", "drop-view", "run", "1").code == 0
    assert json.loads(Path("run/report.json").read_text())["views"] == 2
    assert twin("session", "undo", "run").code == 0
    assert json.loads(Path("run/report.json").read_text())["views"] == 3


def test_a_sweep_that_fits_nowhere_is_left_out_and_named(twin, folder, tmp_path):
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    (mixed / "scan0.csv").write_bytes((folder / "scan0.csv").read_bytes())
    other_scanners.write_readings(mixed / "scan1.csv", sweep(len(PLACES)))
    (mixed / "scan2.csv").write_bytes((folder / "scan1.csv").read_bytes())
    result = twin("import", mixed, "--out", "run")
    assert result.code == 0
    report = json.loads(Path("run/report.json").read_text())
    assert report["views"] == 2
    assert report["warnings"][0].startswith("Sweep 1 is left out: it fits nowhere")
    assert "warning: Sweep 1 is left out" in result.err


def test_a_view_that_fits_elsewhere_as_well_is_called_unsure(twin, tmp_path):
    """A bare square room looks the same after a quarter turn."""
    near, far, high = 1.5, 1.6, 2.5
    square = (
        synthetic.Box((near, -far, 0.0), (far, far, high)),
        synthetic.Box((-far, -far, 0.0), (-near, far, high)),
        synthetic.Box((-far, near, 0.0), (far, far, high)),
        synthetic.Box((-far, -far, 0.0), (far, -near, high)),
    )
    (tmp_path / "hall").mkdir()
    for k, place in enumerate((Pose2(), Pose2(0.1, 0.0, math.radians(44.0)))):
        image = synthetic.observe(
            place, square, width=math.radians(350), step=math.radians(2.0), sigma=0.003,
            rng=np.random.default_rng(k), lidar=sweep(0).spec, room=False,
        ).image  # fmt: skip
        other_scanners.write_readings(tmp_path / f"hall/{k}.csv", image)
    result = twin("import", "hall", "--out", "run", "--json")
    assert result.code == 0
    assert "warning: View 1 is unsure: another place fits almost as well" in result.err
    assert any("View 1 is unsure" in words for words in json.loads(result.out)["warnings"])


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(fails, monkeypatch, folder):
    monkeypatch.setenv("TWIN_FILE_LIMITS", "1e-5")
    assert "TWIN_FILE_LIMITS=" in fails(FILE, "import", folder, "--out", "run")


def test_sweeps_of_different_places_are_no_model(twin, folder, tmp_path):
    (tmp_path / "two").mkdir()
    (tmp_path / "two/a.csv").write_bytes((folder / "scan0.csv").read_bytes())
    other_scanners.write_readings(tmp_path / "two/b.csv", sweep(len(PLACES)))
    result = twin("import", "two", "--out", "run")
    assert result.code == FAILED
    assert "error: none of the 2 sweeps fits the first" in result.err
    assert not Path("run").exists()


def test_the_session_of_an_import_is_imported_again(twin, folder):
    """Its scan lines and transforms say where each reading was, as those of a robot do."""
    assert twin("import", folder / "scan0.csv", "--out", "run").code == 0
    result = twin("import", "run/session.mcap", "--out", "again", "--json")
    assert result.code == 0
    points, again = (json.loads(Path(run, "report.json").read_text())["points"]
                     for run in ("run", "again"))  # fmt: skip
    assert again == pytest.approx(points, rel=0.03)
    heights = [load_session(Path(run)).session.views[0].target.points[:, 2]
               for run in ("run", "again")]  # fmt: skip
    assert np.median(heights[0]) == pytest.approx(np.median(heights[1]), abs=0.02)


def test_laser_scans_are_imported_with_the_thing_that_stands_out(twin, tmp_path):
    other_scanners.write_laser_scans(tmp_path / "bag", other_scanners.turn_like_a_robot(sweep(0)))
    result = twin("import", "bag", "--model", "salient", "--out", "run", "--json")
    assert result.code == 0
    points = json.loads(result.out)["points"]
    assert 0 < points < 0.7 * np.count_nonzero(np.isfinite(sweep(0).ranges))


def test_wrong_options_and_files_leave_nothing_behind(fails, folder):
    assert "--height must" in fails(OPTION, "import", folder, "--height", "-1", "--out", "run")
    assert "--mount must be" in fails(OPTION, "import", folder, "--mount", "1,2", "--out", "run")
    assert "--max-range" in fails(OPTION, "import", folder, "--max-range", "0", "--out", "run")
    assert "there is no nowhere" in fails(FILE, "import", "nowhere", "--out", "run")
    Path("noise.csv").write_bytes(bytes(range(256)) * 10)
    assert "noise.csv" in fails(FILE, "import", "noise.csv", "--out", "run")
    Path("cloud.ply").write_text("ply\n")
    assert "holds points" in fails(FILE, "import", "cloud.ply", "--out", "run")
    assert not Path("run").exists()
