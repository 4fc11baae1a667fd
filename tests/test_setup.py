"""``make`` on a machine that lacks something: one line with cause and cure, and no traceback."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOWHERE = "http://127.0.0.1:9/simple"


@pytest.fixture
def set_up(tmp_path):
    """Run the set-up of an empty checkout and return its one line of error."""
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "setup.sh", tmp_path / "tools")

    def run(python: str | Path, **environment: str) -> str:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PIP_", "UV_"))}
        done = subprocess.run(
            ["sh", "tools/setup.sh"],
            cwd=tmp_path,
            env=clean | {"PYTHON": str(python), "TMPDIR": str(tmp_path)} | environment,
            capture_output=True,
            text=True,
            timeout=100,
        )
        assert done.returncode == 1
        assert all(line.startswith("set-up: ") for line in done.stdout.splitlines())
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1
        return done.stderr

    return run


@pytest.fixture
def impostor(tmp_path):
    """Make a python3 that answers with a shell script where ``pattern`` is asked."""

    def make(pattern: str, answer: str) -> Path:
        path = tmp_path / "python3"
        path.write_text(
            f'#!/bin/sh\ncase "$2" in *{pattern}*) {answer};; esac\nexec {sys.executable} "$@"\n'
        )
        path.chmod(0o755)
        return path

    return make


def test_no_python(set_up):
    assert "python3.99 not found; install Python 3.11" in set_up("python3.99")


def test_a_python_that_does_not_run(set_up, impostor):
    assert "does not run" in set_up(impostor("", "exit 127"))


@pytest.mark.parametrize("version", ["3.9", "3.10", "3.14"])
def test_a_python_of_the_wrong_version(set_up, impostor, version):
    error = set_up(impostor("version_info", f"echo {version}; exit"))
    assert f"is Python {version} but 3.11, 3.12 or 3.13 is needed" in error


def test_a_python_without_venv(set_up, impostor):
    error = set_up(impostor("ensurepip", "exit 1"))
    assert "has no venv module" in error
    assert "apt install python3-venv" in error


def test_no_network(set_up, tmp_path):
    error = set_up(sys.executable, PIP_CONFIG_FILE=os.devnull, PIP_INDEX_URL=NOWHERE)
    assert "the package index does not answer; check the network" in error


def test_a_checkout_that_cannot_be_written(set_up, tmp_path):
    (tmp_path / ".venv").write_text("in the way")
    assert "cannot create .venv in" in set_up(sys.executable)
