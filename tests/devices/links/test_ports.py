"""Emulated devices behind pseudo-terminals and sockets, served in real time."""

import os
import socket
import termios
import time

import numpy as np
import pytest
from virtual import KnownLidar, VirtualClock, values_of

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import LAG, Pace, serve
from scan3d_twin.devices.links.tcp import TcpPort
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.devices.urg.model import LINKS

pytestmark = pytest.mark.slow


class Served:
    """Runs the simulation behind the port while the client reads, in one thread."""

    def __init__(self, port, clock):
        self.port, self.clock = port, clock
        self.started = time.monotonic() - clock.now()

    def now(self):
        """The client's clock; reading it services the device."""
        self.clock.sleep(time.monotonic() - self.started - self.clock.now())
        self.port.service(self.clock.now())
        return self.clock.now()

    def sleep(self, seconds):
        until = self.now() + seconds
        while self.now() < until:
            time.sleep(0.001)


def served(make_port, profile=None):
    clock = VirtualClock()
    port = make_port(Line(UrgEmulator(KnownLidar(clock), profile)))
    return port, Served(port, clock)


@pytest.mark.parametrize(
    ("make_port", "profile"),
    [
        (PtyPort, UrgProfile()),
        (PtyPort, UrgProfile(usb=False, baud=19200, scip1=True)),
        (TcpPort, UrgProfile()),
    ],
    ids=["pty, usb", "pty, serial", "tcp"],
)
def test_the_driver_reads_the_lidar_through_a_port(make_port, profile):
    port, clock = served(make_port, profile)
    lidar = UrgLidar(lambda: SerialTransport(port.path), clock, LINKS["115200"])
    for _ in range(5):
        line = lidar.read_line(2.0)
        turn = KnownLidar.turn_at(line.stamp)
        assert np.array_equal(values_of(line), KnownLidar.values(turn)[206 - 44 : 563 - 44])
    lidar.close()
    clock.sleep(0.15)
    assert not port._line.device.firmware.laser
    port.close()


@pytest.fixture
def pty():
    port, clock = served(PtyPort, UrgProfile(usb=False, baud=115200, tick=0.0))
    yield port, clock
    port.close()


def open_raw(path):
    return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def receive(fd, clock, seconds=0.1):
    until, data = clock.now() + seconds, b""
    while clock.now() < until:
        try:
            data += os.read(fd, 4096)
        except BlockingIOError:
            time.sleep(0.001)
    return data


def set_baud(fd, constant):
    settings = termios.tcgetattr(fd)
    settings[4] = settings[5] = constant
    termios.tcsetattr(fd, termios.TCSANOW, settings)


def test_the_terminal_is_raw_before_anybody_opens_it(pty):
    port, _ = pty
    fd = open_raw(port.path)
    settings = termios.tcgetattr(fd)
    assert not settings[3] & (termios.ECHO | termios.ICANON)
    assert not settings[1] & termios.OPOST
    os.close(fd)


def test_the_clients_bit_rate_counts(pty):
    port, clock = pty
    fd = open_raw(port.path)
    set_baud(fd, termios.B115200)
    assert port.baud == 115200
    os.write(fd, b"QT\n")
    assert receive(fd, clock) == b"QT\n00P\n\n"
    set_baud(fd, termios.B19200)
    os.write(fd, b"QT\n")
    assert b"00P" not in receive(fd, clock)
    set_baud(fd, termios.B500000)
    assert port.baud == 500000
    os.close(fd)


def test_without_a_client_the_bytes_are_lost(pty):
    port, clock = pty
    fd = open_raw(port.path)
    set_baud(fd, termios.B115200)
    os.write(fd, b"MD0384038401000\n")
    assert receive(fd, clock, 0.4).count(b"99b") >= 1
    os.close(fd)
    clock.sleep(0.5)
    fd = open_raw(port.path)
    assert receive(fd, clock, 0.25).count(b"99b") <= 3
    os.close(fd)


def test_a_client_that_does_not_read_loses_bytes_and_does_not_hang_the_device(pty):
    port, clock = pty
    fd = open_raw(port.path)
    set_baud(fd, termios.B115200)
    clock.sleep(0.01)
    for _ in range(50):
        port._line._store(bytes(4000))
        clock.sleep(0.01)
    waiting = len(receive(fd, clock))
    assert 1000 < waiting < 100_000
    os.write(fd, b"QT\n")
    assert receive(fd, clock) == b"QT\n00P\n\n"
    os.close(fd)


def test_a_device_that_is_gone_is_unplugged_for_its_client():
    port, clock = served(PtyPort)
    transport = SerialTransport(port.path)
    clock.now()
    port.close()
    with pytest.raises(LinkError, match="unplugged"):
        transport.read(1.0)
    transport.close()


def test_one_client_after_the_other_by_tcp():
    port, clock = served(TcpPort, UrgProfile(tick=0.0))
    host, number = port.path.removeprefix("socket://").split(":")
    for _ in range(2):
        with socket.create_connection((host, int(number))) as client:
            client.setblocking(False)
            clock.sleep(0.01)
            client.send(b"QT\n")
            assert receive(client.fileno(), clock, 0.05) == b"QT\n00P\n\n"
        clock.sleep(0.01)
    port.close()


def test_a_port_that_is_taken_is_a_link_error():
    first = TcpPort(Line(UrgEmulator(KnownLidar(VirtualClock()))))
    number = int(first.path.rsplit(":", 1)[1])
    with pytest.raises(LinkError, match=f"cannot listen on 127.0.0.1:{number}"):
        TcpPort(Line(UrgEmulator(KnownLidar(VirtualClock()))), port=number)
    first.close()


def test_serving_keeps_pace_with_the_wall():
    clock = VirtualClock()
    calls = []

    class Port:
        path = ""

        def service(self, now):
            calls.append(now)

    started = time.monotonic()
    serve([Port()], clock, ended=lambda: time.monotonic() - started > 0.2)
    assert clock.now() == pytest.approx(0.2, abs=0.1)
    assert len(calls) > 10
    assert calls == sorted(calls)


def test_a_slow_world_is_not_made_to_catch_up_for_ever():
    class Slow(VirtualClock):
        def sleep(self, seconds):
            super().sleep(seconds)
            time.sleep(2 * seconds)

    clock, started = Slow(), time.monotonic()
    serve([], clock, ended=lambda: time.monotonic() - started > 0.2)
    assert 0.03 < clock.now() < 0.2


def test_a_computer_that_keeps_up_loses_no_time():
    pace = Pace(5.0, 100.0)
    assert pace.behind(5.0, 100.2) == pytest.approx(0.2)
    assert pace.behind(5.3, 100.2) == pytest.approx(-0.1)
    assert pace.behind(5.3, 100.8) == pytest.approx(LAG)
    assert pace.lost == 0.0


def test_a_computer_that_is_too_busy_slows_the_world_down_and_says_so(caplog):
    pace = Pace(0.0, 0.0)
    assert pace.behind(0.0, 1.2) == LAG
    assert pace.lost == pytest.approx(0.7)
    assert not caplog.messages
    # Once it keeps up again, the world does not race.
    assert pace.behind(0.5, 1.2) == pytest.approx(0.0)
    assert pace.behind(0.5, 2.1) == LAG
    assert caplog.messages[0].startswith("this computer is too busy: the emulated world has lost")
    assert "1.1 s so far" in caplog.messages[0]
    pace.behind(0.6, 2.2)
    assert len(caplog.messages) == 1
