"""A turntable on the command line: emulated, looked at, and what options mean that there is one."""

import json
import subprocess
import sys

import pytest

from scan3d_twin.cli.checks import check_latency
from scan3d_twin.cli.commands.doctor import TURNTABLE_NOT_ASKED, DoctorOptions, examine
from scan3d_twin.cli.commands.emulate import EmulateOptions, ports
from scan3d_twin.cli.commands.real import (
    RealOptions,
    Turning,
    carry_turntable,
    choose_turning,
    open_robot,
)
from scan3d_twin.cli.options import stated_options
from scan3d_twin.core.errors import ConfigError, LinkError, UnknownNameError
from scan3d_twin.devices.registry import Devices
from scan3d_twin.real.ports import Port, choose_ports, choose_turntable_port, ports_but
from scan3d_twin.real.robot import open_real

TWIN = [sys.executable, "-m", "scan3d_twin.cli"]
RATES = ("base readings", "lidar rate", "turntable readings")
"""What a busy computer may slow down."""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Options that name the ports of an emulated robot with a turntable."""
    folder = tmp_path_factory.mktemp("robot")
    command = [*TWIN, "emulate", "--json", "--turntable", "xl330", "--link", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        where = json.loads(process.stdout.readline())
        assert where == {f"{role}_port": str(folder / role) for role in ROLES}
        yield [f"--{OPTIONS[role]}={where[f'{role}_port']}" for role in ROLES]
        process.terminate()


ROLES = ("base", "lidar", "turntable")
OPTIONS = {"base": "port", "lidar": "lidar-port", "turntable": "turntable-port"}


def call(*arguments):
    return subprocess.run([*TWIN, *arguments], capture_output=True, text=True, timeout=60)


def test_the_doctor_says_what_it_finds_of_it(served):
    findings = {each["what"]: each for each in json.loads(call("doctor", *served, "--json").stdout)}
    assert not [each for each in findings.values() if not each["ok"] and each["what"] not in RATES]
    assert findings["turntable"]["found"].startswith("Dynamixel XL330-M288, firmware 52, id 1 at")
    assert findings["turntable supply"]["found"] == "5.0 V"


def test_a_dry_run_reads_its_angle(served):
    result = call("real", *served, "--dry-run", "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["turntable"] == "xl330"
    assert abs(found["turntable_deg"]) < 0.5


def test_without_a_base_nothing_is_sent_to_it():
    given = {"port": "/dev/nowhere", "lidar_port": "/dev/null", "turntable_port": "/dev/zero"}
    findings = list(examine(DoctorOptions(**given)))
    assert TURNTABLE_NOT_ASKED in findings


def test_an_adapter_that_holds_bytes_back_is_named_with_its_cure(tmp_path):
    file = tmp_path / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
    file.parent.mkdir(parents=True)
    file.write_text("16\n")
    (finding,) = check_latency("/dev/ttyUSB0", tmp_path)
    assert not finding.ok
    assert finding.cure == f"echo 1 | sudo tee {file}"
    file.write_text("1\n")
    (finding,) = check_latency("/dev/ttyUSB0", tmp_path)
    assert finding.ok
    assert list(check_latency("/dev/ttyACM0", tmp_path)) == []


@pytest.mark.parametrize(
    ("given", "pattern"),
    [
        ({}, None),
        ({"turntable": "xl330"}, "yaw"),
        ({"turntable_port": "/dev/ttyUSB1"}, "yaw"),
        ({"turntable": "xl330", "pattern": "pitch"}, "pitch"),
        ({"pattern": "roll"}, "roll"),
    ],
)
def test_a_turntable_that_is_named_turns_the_lidar(given, pattern):
    options = RealOptions(**given)
    assert stated_options(options, {}).get("pattern") == pattern
    assert choose_turning(options).pattern == (pattern or "yaw-base")


def test_a_pattern_in_the_file_is_that_of_the_turntable(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text('pattern = "pitch"\n')
    options = RealOptions(turntable_port="/dev/ttyUSB1", config=file)
    assert stated_options(options, {})["pattern"] == "pitch"


def test_a_turntable_that_turns_nothing_is_refused():
    options = RealOptions(turntable="xl330", pattern="yaw-base")
    with pytest.raises(ConfigError, match="turns nothing by --pattern yaw-base"):
        carry_turntable(options, choose_turning(options))
    assert carry_turntable(RealOptions(), choose_turning(RealOptions())) == (None, None)
    with pytest.raises(UnknownNameError, match=r"no turntable 'ideal'; known: .*xl330"):
        carry_turntable(RealOptions(), Turning("yaw", "ideal"))


def test_its_port_is_found_by_its_usb_id_and_is_not_taken_for_the_base():
    u2d2 = Port("/dev/ttyUSB1", "0403:6014", "USB <-> Serial Converter")
    cable = Port("/dev/ttyUSB0", "0403:6001", "FT232R USB UART")
    assert choose_turntable_port(None, "xl330", [cable, u2d2]) == u2d2.path
    assert choose_turntable_port("/dev/x", "xl330", []) == "/dev/x"
    with pytest.raises(LinkError, match=r"2 ports may be the base"):
        choose_ports(None, "-", None, [cable, u2d2])
    assert choose_ports(None, "-", None, ports_but(u2d2.path, [cable, u2d2]))[0] == cable.path
    with pytest.raises(LinkError, match=r"no turntable found on USB \(Robotis U2D2"):
        choose_turntable_port(None, "xl330", [cable])


def test_one_port_for_it_and_another_device_is_refused():
    given = {"port": "/dev/null", "lidar_port": "/dev/zero", "turntable_port": "/dev/zero"}
    words = "cannot be the port of both lidar and turntable: name another"
    with pytest.raises(LinkError, match=words), open_robot(RealOptions(**given), Devices()):
        pass


def test_the_emulator_refuses_what_it_cannot_serve():
    for options, words in (
        (EmulateOptions(turntable="mx28"), "no turntable 'mx28'"),
        (EmulateOptions(tcp_turntable_port=70000), "--tcp-turntable-port must be within 1 and"),
    ):
        with pytest.raises(ConfigError, match=words), ports(options):
            pass


def test_nothing_is_opened_before_the_base_is_found(monkeypatch):
    from scan3d_twin.real import robot

    def identify(link, clock, base):
        raise LinkError("no base is here")

    class Port:
        def __init__(self, port, baud=115200):
            self.close = lambda: None

        def fileno(self):
            return 0

        def write(self, data):
            pass

    def open_line():
        raise AssertionError

    monkeypatch.setattr(robot, "identify_base", identify)
    monkeypatch.setattr(robot, "SerialTransport", Port)
    monkeypatch.setattr(robot.PortGuard, "watch", lambda self, port: None)
    carried = robot.CarriedTurntable("xl330", open_line, None, None)
    with (
        pytest.raises(LinkError, match="no base is here"),
        open_real("/dev/a", "/dev/b", turntable=carried),
    ):
        pass
