import json
import signal
import subprocess
import sys

import pytest

from scan3d_twin.cli.app import main
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.real.clock import RealClock

EMULATE = [sys.executable, "-m", "scan3d_twin.cli", "emulate"]


@pytest.mark.parametrize(
    ("options", "prefix"),
    [(["--lidar-cable", "serial", "--scip", "1.1"], "/dev/pts/"), (["--tcp"], "socket://")],
)
def test_the_lidar_can_be_read_through_the_port_it_names(options, prefix):
    with subprocess.Popen([*EMULATE, "--json", *options], stdout=subprocess.PIPE) as program:
        ports = json.loads(program.stdout.readline())
        assert set(ports) == {"base_port", "lidar_port"}
        assert all(port.startswith(prefix) for port in ports.values())
        lidar = UrgLidar(lambda: SerialTransport(ports["lidar_port"]), RealClock())
        assert len(lidar.read_line(5.0).ranges) == 682
        lidar.close()
        program.send_signal(signal.SIGTERM)
        assert program.wait(10) == 0
        assert program.stdout.read() == b""


@pytest.mark.parametrize("lidar", ["urg04lx", "rplidar_c1"])
def test_it_says_what_to_run_next(lidar):
    with subprocess.Popen(
        [*EMULATE, "--lidar", lidar], stdout=subprocess.PIPE, text=True
    ) as program:
        words = program.stdout.readline().split()
        program.send_signal(signal.SIGINT)
        assert program.wait(10) == 0
    assert words[:3] == ["twin", "real", "--port"]
    assert words[4] == "--lidar-port"
    assert words[6:] == ([] if lidar == "urg04lx" else ["--lidar", lidar])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--lidar-baud", "9600"], "--lidar-baud must be one of 19200, 38400"),
        (["--corrupt", "0.2"], "--corrupt must be within 0 and 0.1"),
        (["--corrupt", "-1"], "--corrupt must be within 0 and 0.1"),
        (["--scene", "nowhere"], "no scene 'nowhere'"),
        (["--bogus"], "twin emulate --help"),
    ],
)
def test_what_cannot_be_emulated_is_a_wrong_option(capsys, options, words):
    assert main(["emulate", *options]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
