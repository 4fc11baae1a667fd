"""`twin scan` on emulated devices is killed, hung up on or suspended while the robot turns.

Each emergency is tried once; ``SCAN3D_TWIN_EMERGENCIES=20`` tries each 20 times.
"""

import os
import signal
import subprocess
import sys
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from kinematic import JumpingClock, KinematicBase
from virtual import KnownLidar

from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve
from scan3d_twin.devices.urg.emulator import UrgEmulator

pytestmark = [
    pytest.mark.slow,
    pytest.mark.parametrize("attempt", range(int(os.environ.get("SCAN3D_TWIN_EMERGENCIES", "1")))),
]
STOPPED_WITHIN = 0.5
"""Time until the wheels stand [s]."""


class Devices:
    """An emulated base and lidar on pseudo-terminals, in real time, in front of nothing."""

    def __init__(self):
        self.base = KinematicBase()
        self.clock = JumpingClock(self.base)
        self.create = CreateEmulator(self.base)
        self.urg = UrgEmulator(KnownLidar(self.clock))
        self.ports = [PtyPort(Line(self.create)), PtyPort(Line(self.urg))]

    def serve(self, until, timeout=60.0):
        """Serve both ports until something holds; return how long that took [s]."""
        start = self.clock.now()

        def ended():
            assert self.clock.now() - start < timeout
            return until()

        serve(self.ports, self.clock, ended)
        return self.clock.now() - start

    def drives(self):
        return self.base.speed != (0.0, 0.0)

    def serve_for(self, seconds):
        end = self.clock.now() + seconds
        self.serve(lambda: self.clock.now() >= end)

    def close(self):
        for port in self.ports:
            port.close()


@contextmanager
def turning(folder):
    """Yield the devices and the program that turns the robot."""
    with closing(Devices()) as devices:
        base, lidar = (port.path for port in devices.ports)
        command = [sys.executable, "-m", "scan3d_twin.cli", "scan", "--port", base]
        command += ["--lidar-port", lidar, "--width", "340", "--rate", "20", "--out", str(folder)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            try:
                devices.serve(lambda: devices.drives() or process.poll() is not None)
                assert process.poll() is None, process.stderr.read()
                devices.serve_for(0.3)
                yield devices, process
            finally:
                process.kill()


def stops_and_ends(devices, process):
    """The wheels stop at once; return the exit code and the last words of the program."""
    assert devices.serve(lambda: not devices.drives()) < STOPPED_WITHIN
    devices.serve(lambda: process.poll() is not None)
    devices.serve_for(0.3)
    assert not devices.drives()
    assert devices.create.mode is Mode.PASSIVE
    return process.returncode, process.stderr.read()


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda n: n.name
)
def test_an_ending_signal_leaves_both_devices_in_order(attempt, number, tmp_path):
    with turning(tmp_path / "scan") as (devices, process):
        process.send_signal(number)
        assert stops_and_ends(devices, process) == (130, "error: interrupted\n")
        assert not devices.urg.firmware.laser
    assert not (tmp_path / "scan").exists()


def test_kill_9_of_the_program(attempt, tmp_path):
    with turning(tmp_path / "scan") as (devices, process):
        process.kill()
        assert stops_and_ends(devices, process) == (-signal.SIGKILL, "")


def test_kill_9_of_the_guard(attempt, tmp_path):
    with turning(tmp_path / "scan") as (devices, process):
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        (guard,) = map(int, children)
        os.kill(guard, signal.SIGKILL)
        code, words = stops_and_ends(devices, process)
        assert code == 5
        assert "the guard process has ended" in words
        assert not devices.urg.firmware.laser


def test_a_suspension(attempt, tmp_path):
    with turning(tmp_path / "scan") as (devices, process):
        process.send_signal(signal.SIGSTOP)
        assert devices.serve(lambda: not devices.drives()) < STOPPED_WITHIN
        devices.serve_for(1.2)
        process.send_signal(signal.SIGCONT)
        devices.serve(lambda: devices.drives() or process.poll() is not None)
        code, words = stops_and_ends(devices, process)
        assert code == 5
        assert float(words.split("suspended for ")[1].split(" s ")[0]) >= 1.2
