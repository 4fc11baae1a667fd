"""The package of docs/extending.md, built and installed from the page, and used as it says."""

import ast
import json
import os
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from short_runs import COARSE

from scan3d_twin import extend
from scan3d_twin.devices.registry import base_names, lidar_names, turntable_names
from scan3d_twin.recording.load import load_session

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "extending.md"
FILE = re.compile(r"^`([\w./]+)`\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A file of the page: its name on a line of its own, and a block of code."""
BUILD = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"
RUN = ["--max-views", "2", "--planning.trials", "2", "--json", *COARSE]


def with_packages(path):
    """Return the environment in which Python looks into the folders of ``path`` first."""
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, [*map(str, path), *inherited])),
    }


def run(*command, folder, path=(), timeout=240):
    """Run Python in ``folder`` with ``path`` before everything else that it imports."""
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=folder,
        env=with_packages(path),
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the package of the page, installed from a wheel, and its scene beside it."""
    source, target = tmp_path_factory.mktemp("acme"), tmp_path_factory.mktemp("site")
    for name, code in FILE.findall(PAGE.read_text(encoding="utf-8")):
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(code, encoding="utf-8")
        if path.suffix == ".py":
            (path.parent / "__init__.py").touch()
    run("-c", BUILD, target, folder=source)
    (wheel,) = target.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    (source / "crates.xml").rename(target / "crates.xml")
    return target


@pytest.fixture
def twin(site, tmp_path):
    """Calls ``twin`` with the package installed, in an empty folder; returns what it printed."""
    (tmp_path / "crates.xml").write_bytes((site / "crates.xml").read_bytes())
    return lambda *words: run("-m", "scan3d_twin.cli", *words, folder=tmp_path, path=[site])


def test_the_page_shows_every_file(site):
    names = {str(path.relative_to(site)) for path in site.glob("acme_scan/**/*.py")}
    family = {"model", "codec", "driver", "emulator", "device", "__init__"}
    assert {
        f"acme_scan/{device}/{name}.py" for device in ("pico", "rover") for name in family
    } < names


def test_the_page_needs_public_modules_only():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    imports = [
        node
        for block in blocks
        for node in ast.walk(ast.parse(block))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("scan3d_twin")
    ]
    assert {node.module for node in imports} == {"scan3d_twin", "scan3d_twin.extend"}


def test_the_reference_has_every_name_of_the_module_for_other_packages():
    reference = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    entry = re.compile(r"^\.\. (?:auto\w+|py:data):: scan3d_twin\.extend\.(\w+)$", re.MULTILINE)
    listed = entry.findall(reference)
    assert sorted(listed) == sorted(extend.__all__)


@pytest.mark.timeout(600)
def test_the_commands_of_the_page_run_in_order_in_one_folder(site, tmp_path):
    (tmp_path / "crates.xml").write_bytes((site / "crates.xml").read_bytes())
    commands = re.findall(r"^    (twin .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {command.split()[1] for command in commands} == {"sim", "export", "emulate"}
    quick = {"TWIN_MAX_VIEWS": "2", "TWIN_SWEEP_YAW_RATE": "0.5", "TWIN_SWEEP_LOOK_RATE": "1.2"}
    environment = {**with_packages([site]), **quick}
    for command in commands:
        words = [sys.executable, "-m", "scan3d_twin.cli", *shlex.split(command, comments=True)[1:]]
        with subprocess.Popen(
            words,
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            if words[3] == "emulate":
                assert process.stdout.readline().startswith("twin real --port "), command
                process.terminate()
            _, said = process.communicate(timeout=240)
        assert process.returncode == 0, (command, said)
    assert (tmp_path / "runs" / "a" / "cloud.csv").is_file()


def test_the_planner_and_its_option_are_listed_and_checked(twin):
    listed = json.loads(twin("planners", "--json"))
    assert listed["patient"] == "Always the same large overlap. Options: overlap=0.8."
    with pytest.raises(AssertionError, match=r"planner patient.overlap must be <= 0.95, got 1"):
        twin("sim", "--planner", "patient:overlap=1")
    with pytest.raises(
        AssertionError, match=r"no option of planner patient 'speed'; known: overlap"
    ):
        twin("sim", "--planner", "patient:speed=1")


def test_the_devices_are_listed_and_chosen_by_name(twin):
    listed = json.loads(twin("devices", "--json"))
    own = {*base_names(), *lidar_names(), *turntable_names()}
    assert own | {"pico", "rover"} == set(listed)
    with pytest.raises(AssertionError, match=r"no lidar 'sick'; known: .*, pico, .*, urg04lx"):
        twin("sim", "--lidar", "sick")
    with pytest.raises(
        AssertionError, match=r"no robot 'turtlebot'; known: create1, create2, .*, rover"
    ):
        twin("sim", "--robot", "turtlebot")


def test_scene_planner_and_export_format_together(twin, tmp_path):
    words = ["--scene", "crates.xml", "--planner", "patient:overlap=0.9", "--out", "run", *RUN]
    report = json.loads(twin("sim", *words))
    assert report["planner"] == "patient:overlap=0.9"
    plans = load_session(tmp_path / "run").session.plans
    assert (plans[0].overlap, plans[0].reason) == (pytest.approx(0.9), "patient")
    assert "csv" in twin("export", "--help")
    assert twin("export", "run", "--to", "csv") == "run/cloud.csv\n"
    table = np.loadtxt(tmp_path / "run" / "cloud.csv", delimiter=",", skiprows=1)
    assert len(table) > 0.9 * report["points"]
    assert set(table[:, 3]) == {0, 1}


@pytest.mark.timeout(300)
def test_lidar_and_base_scan_in_the_twin(twin, tmp_path):
    report = json.loads(twin("sim", "--robot", "rover", "--lidar", "pico", "--out", "run", *RUN))
    assert report["views"] == 2
    settings = (tmp_path / "run" / "config.toml").read_text()
    for line in (
        'robot = "rover"',
        'lidar_model = "pico"',
        "sigma = 0.006",
        "robot_radius = 0.175",
    ):
        assert line in settings
    with np.load(tmp_path / "run" / "views" / "000.npz") as view:
        assert view["ranges"].shape[1] == 301
        assert view["range_limits"].tolist() == [0.05, 4.0]
    with pytest.raises(AssertionError, match="no lidar link '115200'; known: usb"):
        twin("sim", "--lidar", "pico", "--lidar-link", "115200")


WIRED = """
import json
from scan3d_twin.core.config import Config
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import turn_by
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.wired import open_wired

found = {}
for robot_name, lidar_name in (("rover", "pico"), ("rover", "urg04lx"), ("create2", "pico")):
    with open_wired("three_boxes", 0, TwinConfig(robot_name, lidar_name)) as (robot, truth):
        start = robot.clock.now()
        image = sweep(robot, 0.0, Config(), lambda line: None).image
        stamp = robot.base.odometry().stamp
        there, here = truth.pose_at(stamp), truth.pose_at(start)
        turned = (here.inverse() @ there).yaw - robot.base.odometry().T_odom_base.yaw
        seen = float((image.ranges > 0).mean())
        found[f"{robot_name} {lidar_name}"] = image.ranges.shape[1], seen, turned, robot.lidar.bad
print(json.dumps(found))
"""


@pytest.mark.timeout(300)
def test_drivers_on_emulators_on_the_twin_sweep(site, tmp_path):
    found = json.loads(run("-c", WIRED, folder=tmp_path, path=[site]))
    assert [each[0] for each in found.values()] == [301, 682, 301]
    for beams, seen, turned, bad in found.values():
        assert seen > 0.3, beams
        assert abs(turned) < np.radians(2)
        assert bad == 0


@pytest.mark.timeout(300)
def test_lidar_and_base_keep_the_contract_through_bytes(site):
    words = ["--robot", "rover", "--lidar", "pico", "-k", "wired", "-q", "-p", "no:cacheprovider"]
    said = run("-m", "pytest", "tests/contract", *words, folder=ROOT, path=[site])
    assert re.search(r"\d\d passed", said)


def test_the_script_of_the_page_runs(site, tmp_path):
    script = re.findall(
        r"```python\n(from scan3d_twin import TwinConfig.*?)```", PAGE.read_text(), re.DOTALL
    )
    lines = run("-c", script[0], folder=tmp_path, path=[site]).splitlines()
    assert len(lines) == 3
    assert all("(301,)" in line for line in lines[:2])
    assert float(lines[2]) == 0.006  # as the description of the Pico states it


@pytest.mark.timeout(300)
def test_the_doctor_and_the_real_robot_find_the_emulated_devices(site, twin):
    command = [sys.executable, "-m", "scan3d_twin.cli", "emulate", "--json"]
    words = ["--robot", "rover", "--lidar", "pico"]
    with subprocess.Popen(
        [*command, *words], stdout=subprocess.PIPE, text=True, env=with_packages([site])
    ) as process:
        try:
            ports = json.loads(process.stdout.readline())
            given = ["--port", ports["base_port"], "--lidar-port", ports["lidar_port"]]
            found = json.loads(twin("real", *words, *given, "--dry-run", "--json"))
            assert (found["base"], found["lidar_beams"]) == ("rover", 301)
        finally:
            process.terminate()
