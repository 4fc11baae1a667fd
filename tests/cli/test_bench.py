"""``twin bench`` as people call it, and after whatever ends it before its time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from short_experiments import children, wait_for

from scan3d_twin.bench.journal import read_journals
from scan3d_twin.bench.record import without_timings
from scan3d_twin.bench.store import RESULTS_FILE, read_results

QUICK = ("bench", "--scenes", "shiny_cylinder", "--presets", "paper", "--max-views", "1")
FOUR = (*QUICK, "--seeds", "4")
FAST = (*FOUR, "--jobs", "2")


def lines(folder: Path) -> int:
    journal = folder / "journal.jsonl"
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished bench of four runs."""
    folder = tmp_path_factory.mktemp("bench") / "whole"
    command = [sys.executable, "-m", "scan3d_twin.cli", *FAST, "--out", str(folder), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100)
    document = json.loads(done.stdout)
    assert document["runs"] == 4
    (row,) = document["figures"]
    assert (row["scene"], row["variant"], row["runs"]) == ("shiny_cylinder", "paper", 4)
    assert row["success"] == {
        "value": 0.0,
        "low": 0.0,
        "high": pytest.approx(0.49, abs=0.01),
        "n": 4,
    }
    assert "4/4, 0 s left: shiny_cylinder paper seed" in done.stderr
    return folder


def records(folder: Path) -> list[dict[str, object]]:
    return [without_timings(record) for record in read_results(folder)]


def test_a_bench_leaves_its_journal_its_results_and_a_picture(whole):
    assert {path.name for path in whole.iterdir()} == {"journal.jsonl", RESULTS_FILE, "top_views"}
    assert [path.name for path in (whole / "top_views").iterdir()] == ["shiny_cylinder-paper-0.svg"]
    journal = read_journals([whole / "journal.jsonl"])
    assert sorted(map(str, read_results(whole))) == sorted(map(str, journal.values()))


def test_the_same_command_again_has_nothing_to_do(whole, twin, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    before = (whole / "journal.jsonl").read_bytes()
    result = twin(*FAST, "--out", whole)
    assert result.code == 0
    assert "4 of 4 runs are done already" in result.err
    table = result.out.partition("\n[low, high]")[0].splitlines()
    assert table[0] == "shiny_cylinder"
    assert any(line.startswith("paper    4 ") for line in table)
    assert max(map(len, table)) <= 80
    assert (whole / "journal.jsonl").read_bytes() == before


def test_a_killed_bench_goes_on_and_ends_as_if_nothing_had_been(whole, twin, tmp_path):
    folder = tmp_path / "killed"
    command = [sys.executable, "-m", "scan3d_twin.cli", *FAST, "--out", str(folder)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        wait_for(lambda: lines(folder) > 0)
        server = children(process.pid)
        process.kill()
    assert 0 < (before := lines(folder)) < 4
    assert not (folder / RESULTS_FILE).exists()
    with (folder / "journal.jsonl").open("a") as journal:
        journal.write('{"key": "torn')
    assert twin(*FAST, "--out", folder).code == 0
    assert lines(folder) == 4 > before
    assert records(folder) == records(whole)
    wait_for(lambda: not any(map(_alive, server)))


def test_shards_together_are_the_whole(whole, twin, tmp_path):
    for shard in ("2/3", "1/3", "3/3"):
        alone = ("--shard", shard, "--jobs", "1", "--out", tmp_path / "parts")
        assert twin(*FOUR, *alone).code == 0
    names = {path.name for path in (tmp_path / "parts").glob("journal*")}
    assert names == {f"journal-{k}of3.jsonl" for k in (1, 2, 3)}
    assert records(tmp_path / "parts") == records(whole)


def test_ctrl_c_keeps_what_is_done_and_leaves_no_worker(tmp_path):
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "scan3d_twin.cli", *FAST, "--out", str(folder)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        wait_for(lambda: lines(folder) > 0)
        server = children(process.pid)
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert rest.splitlines()[-1].startswith("error: interrupted; ")
    assert "repeat the command to continue" in rest
    assert "Traceback" not in rest
    wait_for(lambda: not any(map(_alive, server)))


def _alive(pid: int) -> bool:
    return os.path.exists(f"/proc/{pid}")


def test_more_seeds_are_added_to_what_there_is(whole, twin, tmp_path):
    folder = tmp_path / "grown"
    alone = ("--jobs", "1", "--out", folder)
    assert twin(*QUICK, "--seeds", "1", *alone).code == 0
    result = twin(*QUICK, "--seeds", "2", *alone)
    assert "1 of 2 runs are done already" in result.err
    assert records(folder) == records(whole)[:2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "no experiment: give a FILE, --suite smoke"),
        (("--suite", "smok"), "no suite 'smok'; did you mean smoke? Known: "),
        (("--suite", "smoke", "--planners", "fisher"), "give one of FILE, --suite"),
        (("--planners", "fishr"), "no planner 'fishr'; did you mean fisher? Known: "),
        (("--presets", "bst"), "no preset 'bst'"),
        (("--scenes", "nowhere"), "no scene 'nowhere'"),
        (("--planners", "fisher", "--shard", "3/2"), "--shard must be NUMBER/COUNT"),
        (("--planners", "fisher", "--shard", "two"), "--shard must be NUMBER/COUNT"),
        (("--planners", "fisher", "--jobs", "0"), "--jobs must be >= 1"),
        (("--planners", "fisher", "--seeds", "0"), "seeds must be a whole number >= 1"),
        (("--planners", "fisher", "--timeout", "0"), "--timeout must be > 0 s"),
        (("--planners", "fisher", "--max-views", "0"), "max_views must be >= 1"),
        (("--planners", "fisher", "--jobs", "2", "--cluster", "tcp://h:1"), "--jobs is for this"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_mistakes_are_told_in_a_line(fails, arguments, words):
    assert words in fails(2, "bench", *arguments)


def test_a_missing_file_is_told(fails):
    assert "cannot read missing.toml" in fails(3, "bench", "missing.toml")


@pytest.mark.parametrize(
    ("module", "arguments"),
    [("duckdb", ()), ("pebble", ()), ("distributed", ("--cluster", "tcp://127.0.0.1:9"))],
)
def test_a_missing_library_is_named_with_its_cure(fails, monkeypatch, module, arguments):
    monkeypatch.setitem(sys.modules, module, None)
    line = fails(2, *QUICK, "--seeds", "1", *arguments)
    assert module in line.partition(": pip install ")[2].split()
