"""The line between an emulated device and its client."""

import numpy as np
import pytest
from virtual import VirtualClock

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.devices.links.line_model import Faults, Line, Wire


class Parrot:
    """A device that records what it receives and sends ``say`` once."""

    def __init__(self, baud=115200):
        self.baud = baud
        self.heard = []
        self.say = b""

    def receive(self, data, now):
        self.heard.append((now, data))

    def transmit(self, now):
        data, self.say = self.say, b""
        return data


def wire(baud=115200, heard=115200, faults=None, seed=0):
    clock = VirtualClock()
    parrot = Parrot(baud)
    return Wire(Line(parrot, faults or Faults(), seed), clock, heard), parrot, clock


def drain(wire, clock, seconds):
    data, until = b"", clock.now() + seconds
    while clock.now() < until:
        data += wire.read(0.01)
    return data


def test_bytes_take_their_time():
    end, parrot, clock = wire()
    parrot.say = bytes(1152)
    got = 0
    for _ in range(10):
        got += len(end.read(0.0))
        clock.sleep(0.01)
    # 11520 bytes a second.
    assert got == pytest.approx(1152 * 0.9, abs=2)
    assert len(drain(end, clock, 0.02)) == 1152 - got


def test_without_a_speed_bytes_take_no_time():
    end, parrot, _ = wire(baud=0, heard=9600)
    parrot.say = bytes(5000)
    assert len(end.read(0.0)) == 5000


def test_the_device_hears_a_request_when_its_last_byte_is_through():
    end, parrot, clock = wire()
    end.write(b"0123456789")
    end.read(0.0)
    assert parrot.heard == []
    drain(end, clock, 0.01)
    ((when, data),) = parrot.heard
    assert data == b"0123456789"
    assert when == pytest.approx(10 * 10 / 115200, abs=1e-6)


def test_reading_waits_for_the_first_byte_and_no_longer():
    end, parrot, clock = wire()
    assert end.read(0.5) == b""
    assert clock.now() == pytest.approx(0.5, abs=1e-6)
    parrot.say = b"hello"
    assert b"hello".startswith(end.read(0.5))
    assert clock.now() < 0.51


@pytest.mark.parametrize(("sent", "heard"), [(115200, 19200), (19200, 115200), (57600, 115200)])
def test_a_wrong_speed_is_garbage_both_ways(sent, heard):
    end, parrot, clock = wire(sent, heard)
    parrot.say = b"QT\n00P\n\n" * 20
    data = drain(end, clock, 1.0)
    assert data
    assert b"00P" not in data
    end.write(b"QT\n" * 20)
    drain(end, clock, 1.0)
    assert b"QT\n" not in b"".join(data for _, data in parrot.heard)


def test_a_wrong_speed_can_be_silence():
    end, parrot, clock = wire(115200, 19200, Faults(silent=True))
    parrot.say = b"QT\n00P\n\n"
    assert drain(end, clock, 1.0) == b""


def test_a_speed_that_is_put_right_is_heard():
    end, parrot, clock = wire(115200, 19200)
    end.set_baud(115200)
    parrot.say = b"hello"
    assert drain(end, clock, 0.1) == b"hello"


@pytest.mark.parametrize("kind", ["drop", "insert", "flip"])
def test_faults_come_as_often_as_asked_and_from_the_seed(kind):
    def received(seed):
        end, parrot, _ = wire(0, 0, Faults(**{kind: 0.1}), seed)
        parrot.say = bytes(20000)
        return end.read(0.0)

    data = received(1)
    assert data == received(1)
    assert data != received(2)
    if kind == "flip":
        ones = [byte.bit_count() for byte in data]
        assert max(ones) == 1
        assert sum(ones) == pytest.approx(2000, rel=0.1)
    else:
        change = {"drop": -2000, "insert": 2000}[kind]
        assert len(data) - 20000 == pytest.approx(change, rel=0.1)


def test_faults_reach_the_device_too():
    end, parrot, clock = wire(faults=Faults(drop=0.5))
    end.write(bytes(1000))
    drain(end, clock, 0.2)
    assert len(parrot.heard[0][1]) == pytest.approx(500, abs=80)


def test_a_stall_holds_bytes_back_and_loses_none():
    end, parrot, clock = wire(faults=Faults(stalls=2.0, stall=0.3), seed=4)
    sent, got, gaps, last = 0, 0, [], 0.0
    for _ in range(2000):
        parrot.say = b"xy"
        sent += 2
        if data := end.read(0.0):
            got += len(data)
            gaps.append(clock.now() - last)
            last = clock.now()
        clock.sleep(0.005)
    assert got >= sent - 200
    assert 0.25 < max(gaps) < 1.0
    assert 5 < np.sum(np.array(gaps) > 0.2) < 25


def test_what_is_not_read_for_long_is_lost():
    end, parrot, _ = wire(baud=0)
    for _ in range(5):
        parrot.say = bytes(30000)
        end.line._pull(0.0, 0)
    assert len(end.read(0.0)) == 65536


def test_junk_lies_in_the_port_when_it_is_opened():
    end, _, clock = wire(faults=Faults(junk=b"boot"))
    assert end.read(0.0) == b"boot"
    assert Wire(end.line, clock).read(0.0) == b"boot"
    end.discard_input()
    assert end.read(0.0) == b""


def test_discarding_forgets_what_has_arrived_and_no_more():
    end, parrot, clock = wire()
    parrot.say = bytes(100)
    end.read(0.0)
    clock.sleep(50 * 10 / 115200)
    end.discard_input()
    assert len(drain(end, clock, 0.1)) == pytest.approx(50, abs=1)


@pytest.mark.parametrize("action", [lambda w: w.read(0.1), lambda w: w.write(b"x")])
def test_unplugged(action):
    end, _, clock = wire()
    end.line.plugged = False
    with pytest.raises(LinkError, match="unplugged"):
        action(end)
    with pytest.raises(LinkError, match="unplugged"):
        Wire(end.line, clock)
    end.line.plugged = True
    action(end)


def test_what_is_said_into_an_unplugged_line_is_lost():
    end, parrot, clock = wire()
    end.line.plugged = False
    parrot.say = b"lost"
    end.line.receive(clock.now(), 115200)
    end.line.plugged = True
    assert drain(end, clock, 0.1) == b""


def test_a_closed_wire_carries_nothing():
    end, _, _ = wire()
    end.close()
    end.close()
    with pytest.raises(LinkError):
        end.read(0.0)


def test_a_hazard_in_the_world_does_not_reach_the_reader():
    end, parrot, clock = wire()

    class Bumpy(VirtualClock):
        def sleep(self, seconds):
            super().sleep(seconds)
            raise HazardError("bump")

    end._clock = Bumpy()
    assert end.read(0.1) == b""
    assert end._clock.now() == pytest.approx(0.1, abs=1e-6)
    assert parrot.heard == []
    assert clock.now() == 0.0
