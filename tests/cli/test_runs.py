"""``twin runs``, ``twin compare`` and ``twin film``."""

import json
import os
import re
import shutil
from pathlib import Path

import pytest


@pytest.fixture
def two(finished, tmp_path):
    """A finished run, and a copy of it with another report."""
    folder, report = finished
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(folder / "session.mcap", tmp_path / name)
    (tmp_path / "a" / "report.json").write_text(json.dumps(report))
    changed = report | {"coverage_20mm": 0.5, "warnings": ["View 1: its pose may be off."]}
    (tmp_path / "b" / "report.json").write_text(json.dumps(changed))
    return tmp_path / "a", tmp_path / "b"


def test_the_earlier_runs_are_listed_with_their_results(two, twin):
    told = twin("runs", two[0].parent)
    assert told.code == 0
    rows = {line.split(maxsplit=6)[6]: line.split()[:1] for line in told.out.splitlines()[1:]}
    assert rows.keys() == {str(two[0]), f"{two[1]} (1 warning)"}
    assert rows[f"{two[1]} (1 warning)"] == ["2"]
    assert "50%" in told.out
    listed = json.loads(twin("runs", two[0].parent, "--json").out)
    assert {run["folder"] for run in listed} == {str(each) for each in two}
    assert {run["state"] for run in listed} == {"finished"}


def test_runs_that_are_not_whole_are_listed_as_what_they_are(two, twin):
    (two[0] / "report.json").write_text("{")
    (two[1] / "session.mcap").rename(two[1] / "session.mcap.part")
    told = twin("runs", two[0].parent).out
    (two[0] / "report.json").write_text('{"views": "many", "registration": [3]}')
    assert "its report cannot be read" in twin("runs", two[0]).out
    assert f"{two[0]} (its report cannot be read)" in told
    assert f"{two[1]} (not finished: twin session recover" in told


def test_the_report_of_someone_else_is_no_matter_of_trust(two, twin):
    """Numbers written otherwise are read; what is no text or number of a report is not."""
    path = two[0] / "report.json"
    told = json.loads(path.read_text())
    path.write_text(json.dumps(told | {"views": 2.0, "sim_time_s": 30}))
    row = next(line for line in twin("runs", two[0]).out.splitlines() if str(two[0]) in line)
    assert (row.split()[0], row.split()[-1]) == ("2", str(two[0]))
    for odd in ({"views": 1.5}, {"stop_reason": "\ud800"}, {"path_m": 10**400}, {"warnings": [2]}):
        path.write_text(json.dumps(told | odd))
        said = twin("runs", two[0])
        assert (said.code, "(its report cannot be read)" in said.out) == (0, True)
    assert twin("compare", *two, "--out", "both.html").code == 0


def test_the_name_of_a_folder_steers_no_terminal_and_ends_no_command(two, twin, tmp_path):
    """Names are bytes: of another encoding, or with an escape sequence."""
    odd = tmp_path / os.fsdecode(b"r\xff\x1b[31mn")
    two[0].rename(odd)
    for words in (("runs", odd), ("compare", odd, two[1], "--out", odd / "c.html"),
                  ("export", odd, "--to", "xyz"), ("mesh", odd)):  # fmt: skip
        told = twin(*words)
        assert (told.code, told.err) == (0, "")
        assert "r\ufffd\ufffd[31mn" in told.out
        assert "\x1b" not in told.out
    assert json.loads(twin("session", "info", odd, "--json").out)["path"].startswith(str(odd))
    assert "r\ufffd\x1b[31mn" in (odd / "c.html").read_text(encoding="utf-8")


def test_no_runs_and_no_folder_are_told(twin, fails, tmp_path):
    (tmp_path / "empty").mkdir()
    assert twin("runs", "empty").out == "no runs in empty\n"
    assert "no folder runs" in fails(3, "runs")


def test_runs_are_compared_on_one_page(two, twin, tmp_path):
    told = twin("compare", *two, "--out", "both.html")
    assert told.code == 0
    assert told.out.splitlines()[-1] == "both.html"
    page = Path("both.html").read_text(encoding="utf-8")
    assert "All options are the same" in page
    assert not re.findall(r"https?:", page)
    told = json.loads(twin("compare", *two, "--json").out)
    assert [run["name"] for run in told["runs"]] == ["a", "b"]
    assert [run["coverage_20mm"] for run in told["runs"]][1] == 0.5
    assert told["runs"][1]["distance_mm"]["median"] == pytest.approx(0.0, abs=0.1)
    assert told["runs"][1]["in_both"] == 1.0


def test_a_comparison_takes_two_runs(two, fails):
    assert "at least two runs, got 1" in fails(2, "compare", two[0])
    assert "no session in" in fails(3, "compare", two[0], two[0].parent)


def test_a_film_is_made_of_a_run(two, twin, fails):
    told = twin("film", two[0], "--seconds", "1", "--fps", "3", "--out", "short.gif")
    assert (told.code, told.out) == (0, "short.gif\n")
    assert Path("short.gif").read_bytes().startswith(b"GIF89a")
    assert "--fps must be 1 to 60" in fails(2, "film", two[0], "--fps", "0")
    assert "a GIF shows 50" in fails(2, "film", two[0], "--fps", "60", "--out", "film.gif")
    assert "ends in .mp4 or .gif" in fails(2, "film", two[0], "--out", "film.avi")
