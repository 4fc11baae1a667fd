"""Help and lists: what answers at once."""

import json
import os
import subprocess
import sys
from importlib.metadata import version

import pytest

from scan3d_twin import __version__
from scan3d_twin.core.planning import list_planners
from scan3d_twin.sim.scenes.load import scene_names

HEAVY = ("numpy", "scipy", "mujoco", "trimesh", "open3d")
TWIN = [sys.executable, "-m", "scan3d_twin.cli"]
CALLS = (
    [], ["--help"], ["sim", "--help"], ["real", "--help"], ["bench", "--help"],
    ["replay", "--help"], ["options"], ["--version"],
)  # fmt: skip
"""In the order in which one process is asked for them: each shows what it loaded until then."""
PROGRAM = """
import json, sys
from scan3d_twin.cli import main
found = []
for arguments in {calls}:
    code = main(arguments)
    found.append([code, [name for name in {heavy} if name in sys.modules]])
print()
print(json.dumps(found))
"""


def test_help_needs_nothing_heavy_and_the_overview_no_rich_either():
    program = PROGRAM.format(calls=CALLS, heavy=(*HEAVY, "rich"))
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found[:2] == [[0, []]] * 2
    assert [(code, set(loaded) - {"rich"}) for code, loaded in found] == [(0, set())] * len(CALLS)


@pytest.mark.parametrize(("asked", "used"), [(None, "1"), ("3", "3")])
def test_a_run_computes_on_one_thread_unless_told_otherwise(monkeypatch, asked, used):
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.delenv(name, raising=False)
    if asked is not None:
        monkeypatch.setenv(name, asked)
    told = f"print(os.environ[{name!r}])"
    program = f"import os; from scan3d_twin.cli import main; main(['--help']); {told}"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == used


def test_the_version_names_the_package_and_what_it_computes_with(twin):
    found = dict(line.split(None, 1) for line in twin("--version").out.splitlines())
    assert found["scan3d_twin"] == __version__
    assert found["numpy"] == version("numpy")
    assert {"python", "scipy", "mujoco-core", "cyclopts", "platform"} < set(found)


def test_the_completion_knows_commands_and_options(tmp_path):
    home = {**os.environ, "HOME": str(tmp_path)}
    install = [*TWIN, "--install-completion", "--shell", "bash"]
    done = subprocess.run(install, env=home, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    (script,) = (
        path for path in tmp_path.rglob("*") if path.is_file() and "bashrc" not in path.name
    )
    text = script.read_text()
    assert all(word in text for word in ("drop-view", "--resume", "--planning.epsilon"))
    assert subprocess.run(["bash", "-n", script]).returncode == 0


def test_scenes_are_listed_with_a_line_each(twin):
    lines = twin("scenes").out.splitlines()
    assert [line.split()[0] for line in lines] == list(scene_names())
    assert all(len(line.split()) > 4 for line in lines)


def test_planners_are_listed_with_a_line_each(twin):
    lines = twin("planners").out.splitlines()
    assert [line.split()[0] for line in lines] == list(list_planners())
    assert all(len(line.split()) > 2 for line in lines)


def test_lists_are_one_document_with_json(twin):
    assert set(json.loads(twin("scenes", "--json").out)) == set(scene_names())
    assert set(json.loads(twin("planners", "--json").out)) == set(list_planners())


def test_the_help_names_the_exit_codes(twin):
    assert "130 interrupted" in " ".join(twin("--help").out.split())


def test_importing_the_package_imports_nothing_heavy():
    program = "import sys, scan3d_twin; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = {name.partition(".")[0] for name in done.stdout.split()}
    assert "scan3d_twin" in found
    assert not found & {*HEAVY, "cyclopts", "rich"}


def test_a_run_of_the_twin_tells_what_it_does_before_it_loads_what_it_computes_with(tmp_path):
    program = """
import sys
from scan3d_twin.cli import main
from scan3d_twin.cli.commands import sim
def begun(scene, out):
    print(scene, *sys.modules)
    sys.exit()
sim.begun = begun
main(sys.argv[1:])
"""
    command = [sys.executable, "-c", program, "sim", "--out", tmp_path / "run"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    scene, *found = done.stdout.split()
    assert scene == "three_boxes"
    assert "mujoco" in found
    assert not {"scipy", "rosbags", "scan3d_twin.api.run"} & set(found)
