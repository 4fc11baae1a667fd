"""Serial ports, as far as pseudo-terminals and sockets can stand for them."""

import errno
import os
import socket
import subprocess
import sys
import termios
import tty
from contextlib import suppress

import pytest
import serial
from virtual import VirtualClock

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.links import transport
from scan3d_twin.devices.links.transport import Reopening, SerialTransport, Tapped, is_away
from scan3d_twin.real.clock import RealClock


@pytest.fixture
def pty():
    """(master, path of the slave)."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    with suppress(OSError):
        os.close(master)


@pytest.fixture
def port(pty):
    opened = SerialTransport(pty[1])
    yield opened
    opened.close()


def test_bytes_pass_both_ways(pty, port):
    port.write(b"QT\n")
    assert os.read(pty[0], 100) == b"QT\n"
    os.write(pty[0], b"QT\n00P\n\n")
    assert port.read(1.0) == b"QT\n00P\n\n"


def test_nothing_in_time_is_nothing(port):
    clock = RealClock()
    assert port.read(0.0) == b""
    assert port.read(-1.0) == b""
    assert clock.now() < 0.5
    assert port.read(0.05) == b""
    assert clock.now() >= 0.05


def test_input_is_discarded(pty, port):
    os.write(pty[0], b"x" * 3000)
    port.discard_input()
    assert port.read(0.0) == b""


@pytest.mark.parametrize(("baud", "constant"), [(19200, termios.B19200), (57600, termios.B57600)])
def test_the_bit_rate_is_set(pty, port, baud, constant):
    port.set_baud(baud)
    assert termios.tcgetattr(pty[0])[4:6] == [constant, constant]


def test_a_modem_line_that_was_set_stays_so_after_closing(pty, port):
    """With HUPCL the system clears it, and the motor of an RPLIDAR A1 starts again."""
    attributes = termios.tcgetattr(pty[0])
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(pty[0], termios.TCSANOW, attributes)
    port.set_dtr(False)
    assert termios.tcgetattr(pty[0])[2] & termios.HUPCL
    port.set_dtr(True)
    port.set_baud(57600)
    assert not termios.tcgetattr(pty[0])[2] & termios.HUPCL


@pytest.mark.parametrize("baud", [250000, 500000, 750000])
def test_unusual_bit_rates_are_set(port, baud):
    port.set_baud(baud)
    assert port._serial.baudrate == baud


def test_a_bit_rate_the_port_refuses_is_a_link_error(port, monkeypatch):
    def refuse(self, baud):
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(type(port._serial), "baudrate", property(lambda self: 0, refuse))
    with pytest.raises(LinkError, match="cannot do 750000 baud"):
        port.set_baud(750000)


def test_an_unplugged_port_is_a_link_error(pty, port):
    os.close(pty[0])
    with pytest.raises(LinkError, match=r"unplugged .*: check the cable"):
        port.read(1.0)
    with pytest.raises(LinkError, match="unplugged"):
        port.write(b"x")


def test_a_closed_port_is_a_link_error_and_closing_twice_is_not(port):
    port.close()
    port.close()
    with pytest.raises(LinkError):
        port.read(0.0)


def test_a_device_that_takes_no_bytes_is_a_link_error(port, monkeypatch):
    monkeypatch.setattr(transport, "WRITE_TIMEOUT", 0.05)
    with pytest.raises(LinkError, match="accepts no bytes"):
        port.write(bytes(200_000))


def test_one_process_at_a_time(pty, port):
    program = f"import serial; serial.Serial({pty[1]!r}, exclusive=True)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "Could not exclusively lock port" in run.stderr or "busy" in run.stderr


def test_who_holds_the_port_is_named(pty):
    program = (
        f"import serial, sys; p = serial.Serial({pty[1]!r}, exclusive=True);"
        "print('open', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "open\n"
        with pytest.raises(LinkError, match=rf"in use by .*{other.pid} \(python.*end it"):
            SerialTransport(pty[1])
        other.stdin.close()


def test_what_everybody_has_open_is_held_by_nobody():
    with open("/dev/null", "rb"), subprocess.Popen(["sleep", "60"], stdin=subprocess.DEVNULL) as it:
        assert transport.holders("/dev/null") == []
        with pytest.raises(LinkError, match="is no serial port"):
            SerialTransport("/dev/null")
        it.kill()


def test_a_missing_port_is_named():
    with pytest.raises(LinkError, match=r"no port /dev/ttyNONE.*plug"):
        SerialTransport("/dev/ttyNONE")


def test_a_file_is_no_port(tmp_path):
    path = tmp_path / "file"
    path.write_text("")
    with pytest.raises(LinkError, match="no serial port"):
        SerialTransport(str(path))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, r"no permission .*usermod -aG \w+ \$USER.*log in again"),
        (errno.EBUSY, "in use by another process: end it first"),
        (errno.EIO, "cannot open /dev/null"),
    ],
)
def test_other_reasons_why_a_port_does_not_open(monkeypatch, number, words):
    def fail(*arguments, **options):
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(transport, "holders", lambda port: [])
    monkeypatch.setattr(serial, "serial_for_url", fail)
    with pytest.raises(LinkError, match=words):
        SerialTransport("/dev/null")


def test_a_socket_is_a_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = SerialTransport(f"socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            peer.sendall(b"hello")
            assert port.read(1.0) == b"hello"
            port.set_baud(19200)
            port.write(b"QT\n")
            assert peer.recv(10) == b"QT\n"
        with pytest.raises(LinkError, match="end of file"):
            port.read(1.0)
        port.close()


def test_a_socket_nobody_serves():
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    with pytest.raises(LinkError, match=f"cannot connect to socket://127.0.0.1:{number}"):
        SerialTransport(f"socket://127.0.0.1:{number}")


def test_a_tap_sees_what_passes(pty, port):
    heard = []
    tapped = Tapped(port, RealClock(), lambda stamp, way, data: heard.append((way, data)))
    tapped.write(b"QT\n")
    os.write(pty[0], b"00P")
    assert tapped.read(1.0) == b"00P"
    assert tapped.read(0.0) == b""
    tapped.set_baud(19200)
    tapped.discard_input()
    assert heard == [(">", b"QT\n"), ("<", b"00P")]
    tapped.close()


def test_the_real_clock_runs_and_waits():
    clock = RealClock()
    before = clock.now()
    assert 0 <= before < 1
    clock.sleep(0.02)
    clock.sleep(-1.0)
    assert clock.now() - before >= 0.02


class Plug:
    """A port that can be unplugged; records the calls that pass."""

    def __init__(self):
        self.plugged, self.opened, self.passed = True, [], []
        self.clock = VirtualClock()

    def open(self):
        self.opened.append(self.clock.now())
        if not self.plugged:
            raise LinkError("there is no port")
        return self

    def read(self, timeout):
        self._check()
        return b"!"

    def write(self, data):
        self._check()
        self.passed.append(data)

    def set_baud(self, baud):
        self._check()
        self.passed.append(baud)

    def close(self):
        self.passed.append("closed")

    def _check(self):
        if not self.plugged:
            raise LinkError("unplugged")


def test_a_port_that_comes_back_is_opened_again_and_greeted_at_its_old_speed():
    plug, lost = Plug(), []
    link = Reopening(plug.open, plug.clock, b"stop", lambda: lost.append(plug.clock.now()))
    link.set_baud(57600)
    link.write(b"a")
    assert (link.read(1.0), is_away(link)) == (b"!", False)
    plug.plugged = False
    assert (link.read(1.0), is_away(link), lost) == (b"", True, [0.0])
    link.write(b"lost")
    plug.clock.sleep(3.0)
    assert link.read(0.0) == b""
    plug.plugged = True
    plug.passed.clear()
    plug.clock.sleep(0.6)
    assert link.read(0.0) == b"!"
    assert not is_away(link)
    assert plug.passed == [57600, b"stop"]
    link.write(b"b")
    link.close()
    assert plug.passed[2:] == [b"b", "closed"]


def test_an_absent_port_is_tried_less_and_less_often():
    plug = Plug()
    link = Reopening(plug.open, plug.clock, b"stop")
    plug.plugged = False
    link.write(b"x")
    while plug.clock.now() < 5.0:
        link.read(0.0)
        plug.clock.sleep(0.01)
    tried = [b - a for a, b in zip(plug.opened[1:], plug.opened[2:], strict=False)]
    assert plug.opened[1] == pytest.approx(0.1, abs=0.02)
    assert tried[0] == pytest.approx(0.2, abs=0.02)
    assert tried[-1] == pytest.approx(0.25, abs=0.02)
    assert len(tried) < 22


def test_a_port_that_was_never_there_is_an_error_and_others_are_never_away(port):
    plug = Plug()
    plug.plugged = False
    with pytest.raises(LinkError, match="there is no port"):
        Reopening(plug.open, plug.clock, b"stop")
    assert not is_away(port)


def test_a_line_without_modem_lines_has_no_dtr_to_set(pty, port):
    port.set_dtr(True)
    port.set_dtr(False)
    port.write(b"on")
    assert os.read(pty[0], 2) == b"on"


def test_a_port_that_is_away_sets_no_dtr_and_one_that_is_back_does():
    states = []

    class Port:
        def set_dtr(self, on):
            states.append(on)

        def read(self, timeout):
            raise LinkError("unplugged")

        def close(self):
            pass

    clock = VirtualClock()
    line = Reopening(Port, clock, b"")
    line.set_dtr(True)
    line.read(0.0)
    line.set_dtr(False)
    assert states == [True]
