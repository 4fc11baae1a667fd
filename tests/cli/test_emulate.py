import json
import signal
import socket
import subprocess
import sys
from contextlib import closing

import pytest

from scan3d_twin.cli.app import main
from scan3d_twin.cli.commands.emulate import ADAPTER_LATENCY, EmulateOptions, ports
from scan3d_twin.core.errors import FileError, LinkError
from scan3d_twin.devices.create.identification import find_base
from scan3d_twin.devices.links.pty import linked
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
        found = json.loads(program.stdout.readline())
        assert set(found) == {"base_port", "lidar_port"}
        assert all(port.startswith(prefix) for port in found.values())
        lidar = UrgLidar(lambda: SerialTransport(found["lidar_port"]), RealClock())
        assert len(lidar.read_line(5.0).ranges) == 682
        lidar.close()
        program.send_signal(signal.SIGTERM)
        assert program.wait(10) == 0
        assert program.stdout.read() == b""


def test_a_port_has_the_number_that_is_given():
    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    command = [*EMULATE, "--json", "--tcp-base-port", str(number)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as program:
        found = json.loads(program.stdout.readline())
        assert found["base_port"] == f"socket://127.0.0.1:{number}"
        assert found["lidar_port"].startswith("socket://127.0.0.1:")
        taken = pytest.raises(LinkError, match=f"cannot listen on 127.0.0.1:{number}")
        with taken, ports(EmulateOptions(tcp_base_port=number)):
            pass
        program.send_signal(signal.SIGHUP)
        assert program.wait(10) == 0


def test_links_name_the_terminals_until_the_end(tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot/base").symlink_to("/dev/pts/of-an-earlier-one")
    command = [*EMULATE, "--json", "--link", str(tmp_path / "robot")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as program:
        found = json.loads(program.stdout.readline())
        names = {"base_port": tmp_path / "robot/base", "lidar_port": tmp_path / "robot/lidar"}
        assert found == {name: str(path) for name, path in names.items()}
        assert all(str(path.readlink()).startswith("/dev/pts/") for path in names.values())
        with closing(SerialTransport(found["base_port"])) as line:
            assert find_base(line, RealClock()).model.name == "create2"
        program.send_signal(signal.SIGTERM)
        assert program.wait(10) == 0
    assert not list((tmp_path / "robot").iterdir())


def test_a_link_of_another_emulator_stays_and_a_file_is_not_replaced(tmp_path):
    with linked("/dev/pts/1", tmp_path / "base"):
        with linked("/dev/pts/2", tmp_path / "base"):
            pass
        assert not (tmp_path / "base").is_symlink()
        (tmp_path / "base").symlink_to("/dev/pts/3")
    assert (tmp_path / "base").is_symlink()
    (tmp_path / "lidar").write_text("mine")
    with pytest.raises(FileError, match="in the way"), linked("/dev/pts/1", tmp_path / "lidar"):
        pass
    with pytest.raises(FileError, match="cannot make"), linked("x", tmp_path / "lidar/base"):
        pass


def test_a_reply_takes_the_time_of_a_usb_adapter():
    """A client that flushes its input after writing loses no reply that was too fast."""
    with ports(EmulateOptions()) as (clock, served):
        base = served["base"]
        line = base._line
        line.send(bytes([128, 142, 35]), clock.now(), 115200)
        asked, heard = clock.now(), b""
        while not heard:
            clock.sleep(0.0005)
            heard = line.receive(clock.now(), 115200)
        assert heard == bytes([1])
    wire = 4 * 10 / 115200
    assert wire + ADAPTER_LATENCY <= clock.now() - asked < wire + 0.004


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
        (["--tcp-base-port", "0"], "--tcp-base-port must be within 1 and 65535, got 0"),
        (["--tcp-lidar-port", "70000"], "--tcp-lidar-port must be within 1 and 65535"),
        (["--tcp", "--link", "somewhere"], "--link names terminals"),
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
