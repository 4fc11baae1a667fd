"""A process that drives is killed or hangs: the wheels of the emulated base must stop."""

import os
import select
import signal
import subprocess
import sys
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from emulated_base import Road
from virtual import VirtualClock

from scan3d_twin.core.errors import HazardError
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links import guard_process
from scan3d_twin.devices.links.guard import PortGuard, ProcessGuard
from scan3d_twin.real.clock import RealClock
from scan3d_twin.real.suspension import count_continuations

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).with_name("driving.py")


@pytest.fixture
def road():
    with closing(Road()) as opened:
        yield opened


@contextmanager
def driving(road, what):
    """Start the program and wait until it is ready."""
    command = [sys.executable, str(PROGRAM), road.port.path, what]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            road.serve(lambda: select.select([process.stdout], [], [], 0)[0])
            assert process.stdout.readline() == b"ready\n"
            yield process
        finally:
            process.kill()


def moves(road):
    return road.base.speed != (0.0, 0.0)


def test_kill_9_stops_the_wheels_within_half_a_second(road):
    with driving(road, "drive") as process:
        road.serve(lambda: moves(road))
        assert moves(road)
        process.send_signal(signal.SIGKILL)
        assert road.serve(lambda: not moves(road)) < 0.5
        road.serve(lambda: road.device.mode is Mode.PASSIVE, timeout=1.0)


def test_a_stopped_process_stops_the_wheels_within_half_a_second(road):
    with driving(road, "drive") as process:
        road.serve(lambda: moves(road))
        process.send_signal(signal.SIGSTOP)
        assert 0.2 < road.serve(lambda: not moves(road)) < 0.5
        assert road.device.mode is Mode.PASSIVE


@pytest.mark.parametrize(("seconds", "drives_on"), [(0.6, True), (1.3, False)])
def test_a_process_that_was_suspended_for_long_does_not_drive_on(road, seconds, drives_on):
    with driving(road, "drive") as process:
        road.serve(lambda: moves(road))
        process.send_signal(signal.SIGSTOP)
        road.serve(lambda: not moves(road))
        start = road.base.odometry().stamp
        road.serve(lambda: road.base.odometry().stamp > start + seconds - 0.3)
        process.send_signal(signal.SIGCONT)
        if drives_on:
            road.serve(lambda: moves(road))
            return
        road.serve(lambda: moves(road) or process.poll() is not None)
        assert not moves(road)
        assert b"suspended for 1." in process.stdout.read()
        assert road.device.mode is Mode.PASSIVE


def test_a_suspension_counts_while_the_base_drives_and_until_it_stands():
    now, continued = VirtualClock(), [0]
    guard = PortGuard(b"", now, lambda: continued[0])
    guard.beat(False)
    now.sleep(5.0)
    continued[0] += 1
    guard.beat(True)
    now.sleep(5.0)
    guard.beat(True)
    now.sleep(0.9)
    continued[0] += 1
    guard.beat(True)
    now.sleep(1.1)
    continued[0] += 1
    for _ in range(2):
        with pytest.raises(HazardError, match=r"suspended for 1\.1 s"):
            guard.beat(True)
    guard.beat(False)
    guard.beat(True)


def test_continuations_are_counted_until_the_end():
    before = signal.getsignal(signal.SIGCONT)
    with count_continuations() as count:
        assert count() == 0
        os.kill(os.getpid(), signal.SIGCONT)
        assert count() == 1
    assert signal.getsignal(signal.SIGCONT) is before


def test_a_loop_that_hangs_stops_the_wheels(road):
    with driving(road, "hang"):
        road.serve(lambda: moves(road))
        assert 0.6 < road.serve(lambda: not moves(road)) < 1.2


def test_a_loop_that_goes_on_is_left_alone(road):
    with driving(road, "drive"):
        road.serve(lambda: moves(road))
        start = road.base.odometry().stamp
        road.serve(lambda: road.base.odometry().stamp > start + 1.5 or not moves(road))
        assert moves(road)


def test_killed_at_rest_the_base_is_left_in_passive(road):
    with driving(road, "rest") as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
        start = road.base.odometry().stamp
        road.serve(lambda: road.base.odometry().stamp > start + 0.3)
        assert road.device.mode is Mode.PASSIVE
        assert not moves(road)


def test_in_order_everything_ends(road):
    with driving(road, "leave") as process:
        road.serve(lambda: process.poll() is not None)
        assert process.stdout.read() == b"closed\n"
        assert process.returncode == 0
        assert not moves(road)
        assert road.device.mode is Mode.PASSIVE


@contextmanager
def guarded(silence_ms=50):
    """A guard process on a pipe for a port; yields the pipe to it, the port's end, and itself."""
    (told, tell), (port, written) = os.pipe(), os.pipe()
    command = [sys.executable, "-I", "-S", guard_process.__file__]
    words = [str(written), str(told), b"farewell".hex(), str(silence_ms)]
    with subprocess.Popen([*command, *words], pass_fds=(written, told)) as process:
        os.close(told)
        os.close(written)
        try:
            yield tell, port, process
        finally:
            process.kill()
            os.close(port)


def test_a_guard_that_has_heard_of_no_motion_says_nothing_and_ends_when_told():
    with guarded() as (tell, port, process):
        os.write(tell, guard_process.STANDING)
        assert not select.select([port], [], [], 0.3)[0]
        os.write(tell, guard_process.GOODBYE)
        assert process.wait(timeout=10) == 0
        assert os.read(port, 100) == b""
        os.close(tell)


def test_a_guard_says_farewell_once_per_silence_and_ends_with_the_pipe():
    with guarded() as (tell, port, process):
        assert not select.select([port], [], [], 0.3)[0]
        os.write(tell, guard_process.STANDING + guard_process.MOVING)
        assert os.read(port, 100) == b"farewell"
        assert not select.select([port], [], [], 0.3)[0]
        os.close(tell)
        assert process.wait(timeout=10) == 0
        assert os.read(port, 100) == b"farewell"
        assert os.read(port, 100) == b""


def test_a_port_that_is_opened_anew_gets_a_guard_of_its_own():
    ports = [os.pipe() for _ in range(2)]
    guard = PortGuard(b"farewell", RealClock())
    guard.beat(False)
    guard.watch(ports[0][1])
    first = guard._guard._process
    guard.watch(ports[1][1])
    second = guard._guard._process
    assert (first.poll(), second.poll()) == (0, None)
    guard.beat(True)
    assert select.select([ports[1][0]], [], [], 10.0)[0]
    assert not select.select([ports[0][0]], [], [], 0.0)[0]
    guard.close()
    guard.close()
    assert second.poll() == 0
    guard.beat(True)
    for each in (*ports[0], *ports[1]):
        os.close(each)


def test_without_a_guard_it_does_not_drive():
    reader, writer = os.pipe()
    guard = ProcessGuard(writer, b"farewell", RealClock())
    guard._process.kill()
    guard._process.wait()
    with pytest.raises(HazardError, match="guard process has ended"):
        guard.beat(True)
    guard.close()
    os.close(reader)
    os.close(writer)
