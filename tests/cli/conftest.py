import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from scan3d_twin.cli import main


@dataclass(frozen=True)
class Result:
    """What a call of the program gave back."""

    code: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    """Run in an empty folder and without the user's own TWIN_* variables."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("TWIN_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def twin(capfd) -> Callable[..., Result]:
    """Call the program as if from the shell."""

    def call(*arguments: object) -> Result:
        code = main([str(each) for each in arguments])
        captured = capfd.readouterr()
        return Result(code, captured.out, captured.err)

    return call


@pytest.fixture
def fails(twin) -> Callable[..., str]:
    """Call the program, expect one line on standard error, and return it."""

    def call(code: int, *arguments: object) -> str:
        result = twin(*arguments)
        assert result.code == code
        assert result.out == ""
        assert result.err.startswith("error: ")
        assert result.err.count("\n") == 1
        return result.err

    return call


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> tuple[Path, dict[str, object]]:
    """A finished run of two views: its folder and its report."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    scan = ["sim", "--scene", "three_boxes", "--max-views", "2", "--epsilon", "100"]
    assert main([*scan, "--out", str(folder)]) == 0
    return folder, json.loads((folder / "report.json").read_text())
