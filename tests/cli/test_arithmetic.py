"""The bits of a run do not hang on the processor or on the installation."""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from scan3d_twin import arithmetic

ROOT = Path(__file__).resolve().parents[2]
QUICK = (
    "sim", "--scene", "three_boxes", "--max-views", "2", "--seed", "1", "--sweep.yaw-rate", "0.5",
    "--sweep.look-rate", "1.2",
)  # fmt: skip
PROGRAM = "import sys; from scan3d_twin.cli import main; sys.exit(main())"
BARE = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib.machinery import PathFinder
class WithoutExtras(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        extra = name.partition(".")[0] in {extras}
        return None if extra else super().find_spec(name, path, target)
sys.meta_path[:] = [WithoutExtras if each is PathFinder else each for each in sys.meta_path]
from scan3d_twin.core.registration import native
assert native.__file__.startswith(sys.argv[1]), native.__file__
native.engine._level = 1
from scan3d_twin.cli import main
sys.exit(main(sys.argv[2:]))
"""
EXTRAS = {"duckdb", "pebble", "distributed", "laspy", "pye57", "small_gicp"}


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "model.ply").read_bytes()).hexdigest()


def run(command: list[str], out: Path, **environment: str) -> str:
    done = subprocess.run(
        [*command, *QUICK, "--out", str(out)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    return digest(out)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no system compiler to build in another way")
def test_two_differently_built_installs_give_the_same_model(tmp_path: Path) -> None:
    """The checkout, and a wheel without extras: other flags, lowest level, other NumPy loops."""
    here = run([sys.executable, "-c", PROGRAM], tmp_path / "here")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    environment = {**os.environ, "CC": "cc -fno-tree-vectorize -fno-inline"}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, timeout=90)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    bare = [
        sys.executable,
        "-c",
        BARE.replace("{extras}", repr(EXTRAS)),
        str(tmp_path / "installed"),
    ]
    there = run(bare, tmp_path / "there", NPY_DISABLE_CPU_FEATURES="X86_V4")
    assert there == here


def program(code: str, **environment: str) -> str:
    names = ("OPENBLAS_CORETYPE", "OPENBLAS_NUM_THREADS")
    clean = {name: text for name, text in os.environ.items() if name not in names}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**clean, **environment}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return done.stdout.strip()


FIXED = """
import os
{before}
import scan3d_twin
print(os.environ.get("OPENBLAS_CORETYPE"), os.environ.get("OPENBLAS_NUM_THREADS"))
"""


def test_the_loops_are_those_for_haswell_where_there_is_avx2() -> None:
    avx2 = platform.machine() == "x86_64" and arithmetic._has_avx2()
    assert program(FIXED.format(before="")) == f"{'Haswell' if avx2 else None} 1"


def test_whoever_has_chosen_keeps_the_choice() -> None:
    chosen = {"OPENBLAS_CORETYPE": "Prescott", "OPENBLAS_NUM_THREADS": "2"}
    assert program(FIXED.format(before=""), **chosen) == "Prescott 2"


def test_nothing_is_set_that_numpy_no_longer_reads() -> None:
    assert program(FIXED.format(before="import numpy")) == "None None"


def test_without_a_list_of_processors_nothing_is_assumed(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(arithmetic, "CPUINFO", tmp_path / "missing")
    assert not arithmetic._has_avx2()
    (tmp_path / "cpuinfo").write_text("processor : 0\nflags : fpu sse2 avx2 fma\n")
    monkeypatch.setattr(arithmetic, "CPUINFO", tmp_path / "cpuinfo")
    assert arithmetic._has_avx2()
