"""The dress rehearsal: `twin real` over pseudo-terminals, in front of the emulated robot."""

import json
import os
import signal
import subprocess
import sys
import tomllib
from contextlib import closing, contextmanager

import jsonschema
import pytest

from scan3d_twin.cli.commands.real import RealOptions, name_lidar
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.mcap.recovering_reader import read_contents
from scan3d_twin.run.report import report_schema

TWIN = [sys.executable, "-m", "scan3d_twin.cli"]
HEAVY = ("mujoco", "trimesh", "open3d", "matplotlib", "viser")
"""What a run of the real robot leaves out, so that its own small computer will do."""
PIPES = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}


@pytest.fixture(scope="module")
def ports():
    """Options that name the ports of an emulated robot in front of three boxes."""
    with subprocess.Popen([*TWIN, "emulate", "--json"], **PIPES) as process:
        where = json.loads(process.stdout.readline())
        yield ["--port", where["base_port"], "--lidar-port", where["lidar_port"]]
        process.terminate()
        process.communicate()


def call(*arguments, timeout=60):
    return subprocess.run(
        [*TWIN, *map(str, arguments)], capture_output=True, text=True, timeout=timeout
    )


@contextmanager
def started(*arguments):
    with subprocess.Popen([*TWIN, *map(str, arguments)], **PIPES) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_dry_run_reads_everything_and_moves_nothing(ports):
    result = call("real", *ports, "--dry-run", "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["base"] == "create2"
    assert found["hazards"] == []
    assert found["lidar_beams"] == 682
    assert 5.0 < found["lidar_hz"] < 11.0
    assert 0 < found["lidar_seen_percent"] <= 100


def test_another_base_than_is_stated_is_refused(ports):
    result = call("real", *ports, "--dry-run", "--robot", "create1")
    assert result.returncode == 3
    assert result.stderr.startswith("error: the base on the port is no create1: encoder counts")


def topic(each):
    return getattr(each, "topic", "")


RATES = ("base readings", "lidar rate")
"""What a busy computer may slow down."""


def test_the_doctor_finds_nothing_wrong(ports):
    result = call("doctor", *ports, "--json")
    findings = {each["what"]: each for each in json.loads(result.stdout)}
    assert not [each for each in findings.values() if not each["ok"] and each["what"] not in RATES]
    assert findings["base"]["found"].startswith("create2 at 115200 baud, mode Passive")
    assert "URG-04LX" in findings["lidar"]["found"]
    assert set(RATES) < set(findings)


def test_the_doctor_names_cause_and_cure(twin):
    result = twin("doctor", "--port", "/dev/nowhere", "--lidar-port", "/dev/null")
    assert result.code == 3
    assert "BAD  base port: /dev/nowhere does not exist\n     -> plug it in" in result.out
    assert "/dev/null is no serial port" in result.out
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1


def test_the_doctor_asks_no_rplidar_before_a_base_is_found(twin):
    """Its requests may be commands to a base, which may be on that port."""
    given = ["--port", "/dev/nowhere", "--lidar-port", "/dev/null", "--lidar", "rplidar_c1"]
    result = twin("doctor", *given, "--json")
    assert result.code == 3
    findings = {each["what"]: each for each in json.loads(result.out)}
    assert findings["lidar"]["found"] == "not asked"
    assert "a base is first to be found" in findings["lidar"]["cure"]


def test_the_doctor_says_that_one_port_is_given_for_both(twin):
    result = twin("doctor", "--port", "/dev/null", "--lidar-port", "/dev/../dev/null")
    assert result.code == 3
    assert "BAD  ports: one for both" in result.out
    assert "/dev/null, which is /dev/../dev/null," in result.out


@pytest.mark.parametrize("command", [["real", "--dry-run"], ["real"], ["scan"]])
def test_without_a_robot_one_line_says_what_to_do_and_nothing_is_left(command, twin, tmp_path):
    result = twin(*command, "--port", "/dev/nowhere", "--lidar-port", "/dev/nowhere")
    assert result.code == 3
    assert result.out == ""
    assert not list(tmp_path.rglob("*.*"))
    assert result.err.splitlines(keepends=True)[-1] == (
        "error: there is no port /dev/nowhere: plug the device in; `twin doctor` lists the ports\n"
    )


def test_only_one_process_may_hold_a_port(ports):
    with closing(SerialTransport(ports[1])):
        result = call("real", *ports, "--dry-run")
    assert result.returncode == 3
    assert f"is in use by {os.getpid()} (" in result.stderr


def test_two_views_over_pseudo_terminals(ports, tmp_path):
    """End to end; also how much memory it takes and what it imports."""
    program = (
        "import sys; from scan3d_twin.cli import main; code = main(sys.argv[1:]);"
        "print(sorted({name.partition('.')[0] for name in sys.modules}), file=sys.stderr);"
        "sys.exit(code)"
    )
    # A narrow sweep and a quick look around keep the robot's own time short.
    quick = ["--sweep.width", "0.8", "--sweep.yaw-rate", "0.3", "--sweep.look-rate", "1.2"]
    quick += ["--motion.turn-rate", "1.5", "--motion.speed", "0.4"]
    more = ["--max-views", "2", "--epsilon", "100", "--json", "--out", tmp_path / "run"]
    command = [sys.executable, "-c", program, "real", *ports, *quick, *map(str, more)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    jsonschema.validate(report, report_schema())
    assert (report["scene"], report["robot"], report["views"]) == ("real", "create2", 2)
    assert report["coverage_20mm"] is None
    assert report["registration"][0]["converged"]
    assert report["peak_memory_mb"] < 160
    loaded = result.stderr.splitlines()[-1]
    assert not [name for name in (*HEAVY, "scipy") if name in loaded]
    saved = (tmp_path / "run/config.toml").read_text()
    assert saved.startswith("# Run again: twin real --config THIS_FILE\n")
    assert tomllib.loads(saved)["run"]["scene"] == "real"
    names = {path.name for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert names == {
        "model.ply", "report.json", "report.html", "top_view.svg", "config.toml", "session.mcap",
        "000.npz", "001.npz",
    }  # fmt: skip
    raw = [each for each in read_contents(tmp_path / "run/session.mcap") if "serial" in topic(each)]
    assert {topic(each) for each in raw} == {"/serial/base", "/serial/lidar"}
    assert sum(len(each.data) for each in raw) > 100_000

    # The robot stands where it was, so that the run can go on.
    going_on = ["--resume", tmp_path / "run", "--max-views", "3", "--json"]
    result = call("real", *ports, *going_on, timeout=110)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["views"] == 3
    assert "was the robot moved?" not in result.stderr
    session = load_session(tmp_path / "run").session
    stamps = [view.observation.image.stamps.max() for view in session.views]
    assert stamps == sorted(stamps)
    a, b = (session.views[k].observation.T_odom_scan for k in (1, 2))
    assert 0.1 < a.distance(b) < 1.5


def test_ctrl_c_stops_and_leaves_the_base_in_order(ports, tmp_path):
    with started("real", *ports, "--out", tmp_path / "run") as process:
        assert "digitising with the real robot into" in process.stderr.readline()
        assert "looking around" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=20)
    assert process.returncode == 130
    assert rest.splitlines()[-1] == "error: interrupted"
    assert not (tmp_path / "run").exists()
    again = call("doctor", *ports, "--json")
    assert "mode Passive" in again.stdout


def test_one_image_from_here(ports, tmp_path):
    result = call(
        "scan", *ports, "--width", "20", "--rate", "10", "--out", tmp_path / "one", "--json"
    )
    assert result.returncode == 0, result.stderr
    taken = json.loads(result.stdout)
    assert 18 <= taken["lines"] <= 24
    assert taken["points"] > 1000
    assert {path.name for path in (tmp_path / "one").iterdir()} == {"scan.ply", "scan.npz"}


def test_one_image_of_the_twin(twin, tmp_path):
    result = twin("scan", "--scene", "three_boxes", "--width", "20", "--out", tmp_path / "one")
    assert result.code == 0, result.err
    assert "points" in result.out


def test_a_scene_and_a_port_do_not_go_together(fails):
    assert "--scene" in fails(2, "scan", "--scene", "three_boxes", "--port", os.devnull)


def test_auto_is_the_lidar_that_is_plugged_in(monkeypatch, capsys):
    steps = []

    class Port:
        def __init__(self, name):
            steps.append(f"open {name}")

        def close(self):
            steps.append("close")

    def find_lidar(open_line, clock):
        steps.append("ask the lidar")
        return "ld19"

    monkeypatch.setattr("scan3d_twin.devices.links.transport.SerialTransport", Port)
    monkeypatch.setattr(
        "scan3d_twin.real.robot.identify_base", lambda *_: steps.append("identify the base")
    )
    monkeypatch.setattr("scan3d_twin.real.probe.find_lidar", find_lidar)
    named = name_lidar(RealOptions(lidar="auto", port="/dev/pts/8", lidar_port="/dev/pts/9"))
    assert (named.lidar, named.lidar_port, named.port) == ("ld19", "/dev/pts/9", "/dev/pts/8")
    assert capsys.readouterr().err == "lidar on /dev/pts/9: ld19\n"
    assert steps == ["open /dev/pts/8", "identify the base", "close", "ask the lidar"]
    stated = RealOptions(lidar="urg04lx")
    assert name_lidar(stated) is stated


@pytest.mark.parametrize("command", ["sim", "real", "doctor", "scan"])
def test_base_is_another_name_of_robot(command, fails):
    found = fails(2, command, "--base", "stand", "--robot", "create1")
    assert "--robot create1 and --base stand are the same; give one" in found
