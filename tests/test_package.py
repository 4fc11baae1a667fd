"""The package as a stranger gets it: the wheel and the names of its modules."""

import importlib
import pkgutil
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import scan3d_twin

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(
    each.name
    for each in pkgutil.walk_packages(scan3d_twin.__path__, "scan3d_twin.")
    if not each.name.endswith("__main__")
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> set[str]:
    """Names of the files in a freshly built wheel."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())


def test_the_wheel_holds_all_scenes_and_assets(wheel):
    for name in ("assets", "scenes"):
        files = [path for path in (ROOT / name).rglob("*") if path.is_file()]
        assert files
        for path in files:
            assert f"scan3d_twin/_data/{path.relative_to(ROOT)}" in wheel


def test_the_wheel_holds_every_module_and_the_schema(wheel):
    for name in MODULES:
        stem = name.replace(".", "/")
        assert {f"{stem}.py", f"{stem}/__init__.py"} & wheel, name
    assert "scan3d_twin/run/report.schema.json" in wheel
    assert any(name.endswith("licenses/LICENSE") for name in wheel)


def test_the_wheel_holds_nothing_else(wheel):
    assert {name.split("/")[0] for name in wheel} == {
        "scan3d_twin",
        f"scan3d_twin-{scan3d_twin.__version__}.dist-info",
    }


@pytest.mark.parametrize("name", MODULES)
def test_every_module_imports_and_has_the_names_it_promises(name):
    module = importlib.import_module(name)
    for each in getattr(module, "__all__", ()):
        assert hasattr(module, each), each


def test_the_version_is_stated_once_and_for_all():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == scan3d_twin.__version__
    assert f"version: {scan3d_twin.__version__}" in (ROOT / "CITATION.cff").read_text()


def test_messages_name_packages_that_can_be_installed():
    """This package is on no index, so that its own extras can be named in a clone only."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    known = {re.match(r"[\w-]+", each)[0] for extra in extras for each in extra}
    found = set()
    for path in sorted(Path(scan3d_twin.__file__).parent.rglob("*.py")):
        for words in re.findall(r"pip install ([^\"]+)\"", path.read_text(encoding="utf-8")):
            found |= {re.match(r"[\w-]+", each.strip("'"))[0] for each in words.split()}
    assert "rerun-sdk" in found
    assert found <= known
