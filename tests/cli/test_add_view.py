"""``twin scan --add RUN``: views of a stand that was set down by hand."""

import json
import shutil
from hashlib import sha256
from pathlib import Path

import pytest
from recorded import record
from sessions import two_planned_views

from scan3d_twin.cli import main
from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.written_session import read_places

pytestmark = pytest.mark.slow

OPTION, FILE, FAILED = 2, 3, 4


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    """A finished run of one view of a stand."""
    folder = tmp_path_factory.mktemp("stand") / "run"
    given = ["sim", "--base", "stand", "--pattern", "yaw", "--scene", "three_boxes"]
    assert main([*given, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def run(stand, tmp_path):
    """A copy of it that may be changed."""
    shutil.copytree(stand, tmp_path / "run")
    return tmp_path / "run"


def prints(folder: Path) -> dict[str, str]:
    """Return the checksum of each file in ``folder``."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(p.relative_to(folder)): sha256(p.read_bytes()).hexdigest() for p in files}


def test_a_view_is_added_with_report_session_and_pictures(run, twin):
    before = prints(run)
    result = twin("scan", "--add", run, "--place", "0.1,0.3,-20", "--json")
    assert result.code == 0
    report = json.loads(result.out)
    assert report == json.loads((run / "report.json").read_text())
    assert report["views"] == 2
    (row,) = report["registration"]
    assert row["error_mm"] < 5
    assert row["error_mm"] < 3 * row["predicted_rmse_mm"]
    assert row["odometry_error_mm"] is row["correction_mm"] is None

    # Its place is that where the stand was set down
    session = load_session(run).session
    assert not session.views[1].observation.has_odometry
    moved = session.views[0].T_world_scan.inverse() @ session.views[1].T_world_scan
    assert (moved.x, moved.y) == pytest.approx((0.1, 0.3), abs=0.01)
    assert len(read_places(run / "session.mcap")) == 1
    now = prints(run)
    renewed = ("model.ply", "report.json", "report.html", "top_view.svg", "session.mcap")
    assert all(now[name] != before[name] for name in renewed)
    assert "views/001.npz" in now
    assert not list(run.glob(".add-*"))

    # It can be taken back, and the truth of the rest stays known
    assert twin("session", "undo", run).code == 0
    assert json.loads((run / "report.json").read_text())["views"] == 1
    assert twin("session", "undo", run).code == 0
    again = json.loads((run / "report.json").read_text())
    assert again["registration"][0]["error_mm"] == pytest.approx(row["error_mm"], abs=0.5)
    assert "identical" in twin("replay", run).out


def test_a_view_that_fits_nowhere_leaves_the_run_as_it_was(run, twin):
    before = prints(run)
    result = twin("scan", "--add", run, "--place", "0,0,180")
    assert result.code == FAILED
    assert "error: view 1: it fits nowhere" in result.err
    assert prints(run) == before


def test_wrong_options_are_refused(run, fails, tmp_path):
    assert "leave out --scene" in fails(OPTION, "scan", "--add", run, "--scene", "sine_box")
    assert "--place must be" in fails(OPTION, "scan", "--add", run, "--place", "1,2")
    assert "--place is for" in fails(OPTION, "scan", "--place", "1,2,3")
    assert "no session in" in fails(FILE, "scan", "--add", tmp_path)
    record(tmp_path / "driven", two_planned_views())
    assert "which drives" in fails(OPTION, "scan", "--add", tmp_path / "driven")
