import math

import pytest

from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2
from scan3d_twin.devices.create.link import (
    POLL_PERIOD,
    POLL_TIMEOUT,
    Contact,
    Poll,
    base_spec,
    is_plausible,
)
from scan3d_twin.devices.create.packets import Mode, Packet, encode_packets

SAFE = {
    Packet.BUMPS_DROPS: 31,
    Packet.OVERCURRENTS: 31,
    Packet.CHARGING_SOURCES: 3,
    Packet.MODE: Mode.FULL,
    Packet.REQUESTED_RIGHT: 500,
    Packet.REQUESTED_LEFT: -500,
    Packet.CLIFF_LEFT: 1,
    Packet.CLIFF_RIGHT: 1,
}
"""Largest valid value by packet."""


@pytest.mark.parametrize("offset", [0, 1])
def test_the_largest_readings_are_plausible_and_larger_ones_are_not(offset):
    contact = Contact(CREATE2, 115200, offset)
    values = {**SAFE, Packet.MODE: Mode.FULL + offset}
    assert is_plausible(values, contact)
    for packet, value in values.items():
        beyond = value - 1 if value < 0 else value + 1
        assert not is_plausible({**values, packet: beyond}, contact), packet
    assert is_plausible({**values, Packet.MODE: offset}, contact)
    assert not is_plausible({**values, Packet.MODE: offset - 1}, contact)


def test_a_create_1_counts_whole_millimetres_and_a_create_2_its_encoder():
    spec = base_spec(CREATE1, streams=True)
    assert spec.counts_per_turn == pytest.approx(78.0 * math.pi)
    assert base_spec(CREATE2, streams=True).counts_per_turn == 508.8
    assert (spec.sample_period, base_spec(CREATE1, streams=False).sample_period) == (0.015, 0.03)


class Asked:
    """A line that records what was written."""

    def __init__(self):
        self.written = []

    def write(self, data):
        self.written.append(data)

    def discard_input(self):
        pass


PACKETS = (Packet.MODE, Packet.VOLTAGE)
ANSWER = encode_packets(PACKETS, {Packet.MODE: 2, Packet.VOLTAGE: 15000})


@pytest.fixture
def polled():
    """Return a source that sent its first poll at 1 s, and its line."""
    line = Asked()
    poll = Poll(line, PACKETS)
    assert poll.take(b"", 0.0) == []
    assert poll.take(b"", 1.0) == []
    return poll, line


def test_a_poll_waits_until_the_line_is_quiet_before_it_asks():
    line = Asked()
    poll = Poll(line, PACKETS)
    poll.take(b"\x01", 5.0)
    poll.take(b"", 5.0 + 0.9 * POLL_TIMEOUT)
    assert line.written == []
    poll.take(b"", 5.0 + POLL_TIMEOUT)
    assert line.written == [oi.query(PACKETS)]


def test_a_poll_asks_again_one_period_after_it_asked(polled):
    poll, line = polled
    assert poll.take(ANSWER[:2], 1.005) == []
    (values,) = poll.take(ANSWER[2:], 1.010)
    assert values == {Packet.MODE: 2, Packet.VOLTAGE: 15000}
    poll.take(b"", 1.0 + 0.9 * POLL_PERIOD)
    assert len(line.written) == 1
    poll.take(b"", 1.0 + POLL_PERIOD + 1e-9)
    assert len(line.written) == 2
    assert poll.bad == 0


def test_an_answer_that_is_too_long_or_too_late_is_dropped_and_counted(polled):
    poll, line = polled
    assert poll.take(ANSWER + b"\x00", 1.01) == []
    assert (poll.bad, poll.errors) == (1, 1)
    poll.take(b"", 1.05)
    assert len(line.written) == 2
    assert poll.take(b"", 1.05 + 1.01 * POLL_TIMEOUT) == []
    assert poll.bad == 2
    assert len(line.written) == 3
