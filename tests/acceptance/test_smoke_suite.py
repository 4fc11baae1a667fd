"""The suite `smoke` as a user runs it: two scenes, three planners, three seeds, from end to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from scan3d_twin.bench.store import read_results


def test_the_smoke_suite_runs_through(tmp_path: Path) -> None:
    """Under 60 s on two quiet processors, of which it says so itself: its processor time counts."""
    program = [sys.executable, "-m", "scan3d_twin.cli", "bench"]
    command = [*program, "--suite", "smoke", "--jobs", "2", "--out", str(tmp_path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=560, check=False)
    assert done.returncode == 0, done.stderr
    records = read_results(tmp_path)
    assert json.loads(done.stdout)["runs"] == len(records) == 18
    assert {record.status for record in records} == {"done"}
    assert {record.views for record in records} == {2}
    assert all(record.max_error is not None and record.coverage > 0 for record in records)
    assert {record.planner for record in records} == {"siicp", "fisher", "fixed50"}
    assert sum(record.cpu or 0.0 for record in records) < 2 * 50.0
    assert len(list((tmp_path / "top_views").iterdir())) == 6
    report = subprocess.run([*program, "report", str(tmp_path)], check=False)
    assert report.returncode == 0
    assert (tmp_path / "report" / "report.html").stat().st_size > 100_000
