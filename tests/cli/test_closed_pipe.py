"""`twin ... | head`: a reader that is gone is no error, and does not end a run."""

import os
import subprocess
import sys

import pytest
from short_runs import ONE_VIEW

TWIN = [sys.executable, "-m", "scan3d_twin.cli"]


def unread(*arguments, stream="stdout"):
    """Run the program with a ``stream`` that nobody reads; return its exit code and the others."""
    reader, writer = os.pipe()
    os.close(reader)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: writer}
    command = [*TWIN, *map(str, arguments)]
    done = subprocess.run(command, **streams, text=True, timeout=100, check=False)
    os.close(writer)
    return done


@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",), ("sim", "--help"), ("session", "--help"), ("--version",), ("options",),
        ("planners",), ("scenes", "--json"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_lists_and_help(arguments):
    done = unread(*arguments)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_is_printed_of_a_run(finished):
    done = unread("session", "info", finished[0])
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("arguments", [("sim", "--epsilom", "3"), ("options", "planing")], ids=str)
def test_an_error_that_nobody_reads_keeps_its_code(arguments):
    done = unread(*arguments, stream="stderr")
    assert (done.returncode, done.stdout) == (2, "")


def test_a_run_goes_on_when_nobody_reads_its_progress(tmp_path):
    done = unread(*ONE_VIEW, "--out", tmp_path / "run", stream="stderr")
    assert done.returncode == 0
    assert "1 view, " in done.stdout
    assert (tmp_path / "run" / "model.ply").is_file()
