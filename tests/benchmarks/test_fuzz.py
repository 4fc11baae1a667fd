"""A sample of benchmarks/fuzz.py: damaged files of each kind end in one line, or are read."""

import sys
import time
from pathlib import Path
from random import Random

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
pytest.importorskip("duckdb", reason="needs the extra bench")

from fuzz_imports import SOURCES
from fuzz_inputs import KINDS, make_base

from scan3d_twin.core.errors import TwinError

SEED, COUNT = "a test's own", 5
MAX_TIME = 5.0
"""Processor time that an input may take [s]."""


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """The right files."""
    return make_base(tmp_path_factory.mktemp("base"))


def refusal(read, path):
    """Return why ``path`` is refused; None if it is read. Any other error is a failure."""
    try:
        read(path)
    except TwinError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", [name for name in KINDS if name != "recover"])
def test_a_damaged_file_is_read_or_refused_in_one_line(base, tmp_path, name):
    kind, refused = KINDS[name], 0
    for number in range(COUNT):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = kind.make(base, Random(f"{SEED} {name} {number}"), folder)
        began = time.process_time()
        said = refusal(kind.read, path)
        refused += said is not None
        assert len((said or "").splitlines()) <= 1
        assert time.process_time() - began < MAX_TIME
    assert refused


@pytest.mark.parametrize("name", [name for name in KINDS if name != "recover"])
def test_the_right_files_are_read(base, tmp_path, name):
    source = {
        "mcap": "one/session.mcap", "toml": "config.toml", "spec": "spec.toml", "npz": "view.npz",
        "journal": "journal.jsonl", "report": "report.json", "parquet": "results.parquet",
        "scene": "scene.xml", **SOURCES,
    }.get(name, f"mesh.{name}")  # fmt: skip
    path = tmp_path / Path(source).name
    path.write_bytes((base / source).read_bytes())
    KINDS[name].read(path)
