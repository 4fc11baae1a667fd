import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from cyclopts import App
from short_runs import TWO_VIEWS

from scan3d_twin.cli import main
from scan3d_twin.cli.app import app


@dataclass(frozen=True)
class Result:
    """What a call of the program gave back."""

    code: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    """Run in an empty folder, on a terminal of 100 columns, without the user's own variables.

    A console keeps the width that it found first.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    for name in [name for name in os.environ if name.startswith("TWIN_")]:
        monkeypatch.delenv(name)


@pytest.fixture(scope="session")
def commands() -> list[App]:
    """All commands that do something, those of `twin session` and `twin bench` among them."""
    groups = [app, app["session"], app["bench"]]
    found = [each[name] for each in groups for name in each if not name.startswith("-")]
    return [command for command in found if command.default_command]


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
    assert main([*TWO_VIEWS, "--out", str(folder)]) == 0
    return folder, json.loads((folder / "report.json").read_text())
