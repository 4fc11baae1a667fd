"""The command line beside libraries that a plugin or a notebook has loaded."""

import subprocess
import sys

import pytest

COMMANDS = """
import pydantic
from scan3d_twin.cli import main
for command in (
    ["sim", "--scene", "nowhere.xml"],
    ["sim", "--scene", "nowhere.xml", "--planning.trials", "3"],
    ["replay", "nowhere"],
    ["real", "--robot", "nothing"],
    ["bench", "nowhere.toml"],
):
    print(main(command))
"""


def test_pydantic_does_not_judge_the_options():
    """Cyclopts validates with pydantic as soon as anything, such as Open3D, has imported it."""
    pytest.importorskip("pydantic")
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS], capture_output=True, text=True, timeout=60
    )
    assert "validation error" not in done.stderr
    words = [
        "no file nowhere.xml",
        "no file nowhere.xml",
        "no session in nowhere",
        "nothing",
        "nowhere.toml",
    ]
    for line, word in zip(done.stderr.splitlines(), words, strict=True):
        assert word in line
