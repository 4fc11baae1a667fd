"""Runs that are killed at any moment, recovered and gone on with."""

import json
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from short_runs import TWO_VIEWS

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.load import find_session_file, load_session, read_lines

RESULTS = ("model.ply", "config.toml", "top_view.svg", "views/000.npz", "views/001.npz")


TOLD = """
import os, sys
from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.cli import main
def on_line(self, line):
    os.write(2, f"line {line.stamp!r}\\n".encode())
ViewSaver.on_line = on_line
sys.exit(main(sys.argv[1:]))
"""
"""The program, but that it tells of each line as soon as the recorder has it."""


def kill(folder, words, count):
    """Kill a run ``count`` lines after it has said ``words``; return the stamp of its last line."""
    command = [sys.executable, "-c", TOLD, *TWO_VIEWS, "--out", str(folder)]
    told, said = [], False
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            said = said or line.startswith(words)
            if line.startswith("line "):
                told.append(float(line.split()[1]))
                count -= said
            if said and count <= 0:
                process.kill()
                break
        told += [float(line.split()[1]) for line in process.stderr if line.startswith("line ")]
    return told[-1]


def test_a_killed_run_goes_on_as_if_nothing_had_been(finished, twin, tmp_path):
    """Killed in the sweep of the second view."""
    folder, whole = finished
    kill(tmp_path / "run", "driving to viewpoint 1", 30)
    recorded = load_session(tmp_path / "run")
    assert not recorded.finished
    assert len(recorded.session.views) == 1
    assert recorded.session.stop_reason == ""
    result = twin("sim", "--resume", "run", "--json")
    assert result.code == 0
    assert "driving through the first" in result.err
    for name in RESULTS:
        assert (folder / name).read_bytes() == Path("run", name).read_bytes(), name
    report = json.loads(result.out)
    for name in ("registration", "path_m", "turn_deg", "sim_time_s", "coverage_20mm"):
        assert report[name] == whole[name]
    assert load_session(Path("run")).finished
    assert Path("run/session.1.mcap.part").exists()


@pytest.mark.parametrize("seed", range(3))
def test_a_run_killed_at_any_moment_loses_less_than_a_second(tmp_path, finished, seed):
    """Of the robot's clock; what is left is the same, and in order."""
    every = [line.stamp for line in read_lines(finished[0] / "session.mcap")]
    count = int(np.random.default_rng(seed).integers(1, len(every)))
    last = kill(tmp_path / "run", "looking around", count)
    left = [line.stamp for line in read_lines(find_session_file(tmp_path / "run"))]
    assert left == every[: len(left)]
    assert left[-1] > last - 1.0
    taken = json.loads((finished[0] / "report.json").read_text())["views"]
    with suppress(FileError):
        assert 1 <= len(load_session(tmp_path / "run").session.views) <= taken


def test_a_finished_run_goes_on_with_other_options(finished, twin, tmp_path):
    shutil.copytree(finished[0], tmp_path / "run")
    result = twin("sim", "--resume", "run", "--max-views", "3", "--json")
    assert result.code == 0
    report = json.loads(result.out)
    assert report["views"] == 3
    assert report["path_m"] > finished[1]["path_m"]
    for name in ("views/000.npz", "views/001.npz"):
        with np.load(finished[0] / name) as was, np.load(Path("run", name)) as now:
            # More views align all of them anew, and may show that more belongs to the target.
            assert np.array_equal(was["ranges"], now["ranges"], equal_nan=True)
            before, after = (set(map(tuple, each["target_points"])) for each in (was, now))
            assert before <= after
            assert len(after) <= 1.05 * len(before)
    assert len(load_session(Path("run")).session.views) == 3


def test_a_finished_run_has_nothing_to_go_on_with(finished, twin, tmp_path):
    shutil.copytree(finished[0], tmp_path / "run")
    result = twin("sim", "--resume", "run")
    assert result.code == 0
    assert "2 views" in result.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--seed", "1"], "--resume continues with the run's own scene, seed"),
        (["--world", "harsh"], "--resume continues with the run's own scene, seed"),
        (["--out", "other"], "leave out --out"),
        (["--planner", "none"], "no planner 'none'"),
    ],
)
def test_a_run_goes_on_as_the_same_run(finished, fails, arguments, words):
    assert words in fails(2, "sim", "--resume", finished[0], *arguments)


def test_a_run_of_the_twin_is_none_of_the_robot(finished, fails):
    assert "twin sim --resume" in fails(2, "real", "--resume", finished[0])


def test_what_cannot_go_on_stays_as_it_is(finished, fails, tmp_path):
    shutil.copytree(finished[0], tmp_path / "run")
    before = (tmp_path / "run/session.mcap").read_bytes()
    assert fails(2, "sim", "--resume", "run", "--target", "9,9")
    assert (tmp_path / "run/session.mcap").read_bytes() == before
    assert {path.name for path in (tmp_path / "run").glob("session*")} == {"session.mcap"}
