"""The public interface: its names, its weight, and the example in every docstring."""

import ast
import doctest
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import scan3d_twin as s3d

STUB = Path(s3d.__file__).with_suffix(".pyi")


@pytest.fixture(scope="module")
def names():
    """What the examples take for granted: the modules, and a session with its truth."""
    with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
        session = s3d.digitize(robot, s3d.Config(max_views=2))
        yield {
            "s3d": s3d, "np": np, "math": math, "tempfile": tempfile,
            "session": session, "truth": truth,
        }  # fmt: skip


def test_every_name_of_the_stub_is_public_and_there():
    imports = [
        node for node in ast.parse(STUB.read_text()).body if isinstance(node, ast.ImportFrom)
    ]
    listed = {alias.name for node in imports for alias in node.names}
    assert listed == set(s3d.__all__)
    assert set(s3d.__all__) <= set(dir(s3d))
    assert 20 <= len(s3d.__all__) <= 32


@pytest.mark.parametrize("name", s3d.__all__)
def test_the_example_of_each_public_name_runs(name, names):
    thing = getattr(s3d, name)
    examples = doctest.DocTestFinder(recurse=isinstance(thing, type)).find(
        thing, name, globs=dict(names)
    )
    assert any(each.examples for each in examples), f"{name} has no example"
    flags = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL * (name == "open_real")
    runner = doctest.DocTestRunner(optionflags=flags)
    for each in examples:
        report: list[str] = []
        failed, _ = runner.run(each, out=report.append)
        assert not failed, "".join(report)


def test_the_import_loads_nothing_heavy():
    program = "import sys, scan3d_twin; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()
    for heavy in ("numpy", "scipy", "mujoco", "cyclopts", "trimesh", "gymnasium", "viser"):
        assert heavy not in loaded


def test_what_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = s3d.no_such_name


def test_a_truth_of_another_run_is_refused(names):
    refused = pytest.raises(s3d.TwinError, match="the very run that scanned it")
    with s3d.open_sim("three_boxes", seed=0) as (_, fresh), refused:
        s3d.evaluate(names["session"], fresh)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"seed": -1}, "seed must be >= 0"), ({"config": s3d.Config()}, "must be a TwinConfig")],
)
def test_wrong_arguments_of_the_twin_are_errors_of_ours(arguments, words):
    with pytest.raises(s3d.TwinError, match=words), s3d.open_sim("three_boxes", **arguments):
        pass


def test_a_negative_voxel_is_an_error_of_ours(names, tmp_path):
    with pytest.raises(s3d.TwinError, match="voxel must be >= 0"):
        s3d.export_model(names["session"], tmp_path / "model.ply", voxel=-1.0)


@pytest.mark.parametrize(
    ("format", "unit", "words"),
    [
        ("e57", "mm", "e57 files are in metres"),
        ("ply", "inch", "unknown unit 'inch'; known: m, mm"),
    ],
)
def test_a_unit_that_a_file_cannot_have_is_an_error_of_ours(format, unit, words, names, tmp_path):
    with pytest.raises(s3d.TwinError, match=words):
        s3d.export_model(names["session"], tmp_path / "model", format, unit=unit)


def test_a_session_compares_and_shows_itself(names):
    session = names["session"]
    assert session == session
    assert len({session, session}) == 1
    assert repr(session).startswith("<Session of 2 views: ")
