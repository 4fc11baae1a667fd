"""Packets of the LDROBOT lidars: bytes of the reference, and what a bad line makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.devices.ldrobot.codec import SIZE, Packet, Splitter, crc8, decode, encode

PLAIN = bytes.fromhex(
    "542C100E0000E803C8E903C8EA03C8EB03C8EC03C8ED03C8EE03C8EF03C8F003C8F103C8F203C8F303C87003000014"
)
"""10 Hz, from 0 to 8.80 deg, 1000 to 1011 mm; accepted by the maker's decoder."""
WRAPPED = bytes.fromhex(
    "542C100EAC8AF401E4F501E4F601E4F701E4F801E4F901E4FA01E4FB01E4FC01E4FD01E4FE01E4FF01E47C010500D0"
)
"""From 355.00 to 3.80 deg."""
WITH_INVALID = bytes.fromhex("542C100EE803E803C8000000" + 10 * "D20425" + "58072F7574")
"""The second reading invalid; time 29999."""

packets = st.builds(
    Packet,
    st.integers(0, 65535),
    st.integers(0, 35999),
    st.integers(0, 35999),
    st.integers(0, 29999),
    st.tuples(*[st.integers(0, 65535)] * 12),
    st.tuples(*[st.integers(0, 255)] * 12),
)


def test_the_checksum_has_the_known_check_value() -> None:
    assert crc8(b"123456789") == 0xC3


@pytest.mark.parametrize(
    ("data", "start", "end", "distances", "time"),
    [
        (PLAIN, 0, 880, tuple(range(1000, 1012)), 0),
        (WRAPPED, 35500, 380, tuple(range(500, 512)), 5),
        (WITH_INVALID, 1000, 1880, (1000, 0, *10 * (1234,)), 29999),
    ],
)
def test_known_packets(
    data: bytes, start: int, end: int, distances: tuple[int, ...], time: int
) -> None:
    packet = decode(data)
    assert packet is not None
    assert (packet.speed, packet.start, packet.end, packet.time) == (3600, start, end, time)
    assert packet.distances == distances
    assert packet.span == 880
    assert encode(packet) == data


@given(packets)
def test_a_packet_survives_the_way_through_bytes(packet: Packet) -> None:
    data = encode(packet)
    assert len(data) == SIZE == 47
    assert decode(data) == packet


@given(st.lists(packets, max_size=5), st.integers(0, 2**32 - 1), st.binary(max_size=30))
def test_packets_are_found_in_bytes_cut_anywhere(
    sent: list[Packet], seed: int, junk: bytes
) -> None:
    data = b"".join(map(encode, sent))
    cuts = np.sort(np.random.default_rng(seed).integers(0, len(data) + 1, 6))
    splitter, found = Splitter(), []
    for part in np.split(np.frombuffer(data, np.uint8), cuts):
        found += splitter.feed(part.tobytes())
    assert found == sent
    assert splitter.bad == 0


def test_every_flipped_bit_is_seen_and_costs_that_packet_alone() -> None:
    for bit in range(8 * SIZE):
        broken = bytearray(WRAPPED)
        broken[bit // 8] ^= 1 << bit % 8
        splitter = Splitter()
        found = splitter.feed(PLAIN + bytes(broken) + PLAIN + PLAIN)
        assert found == [decode(PLAIN)] * 3, bit
        assert splitter.bad == 1, bit


@pytest.mark.parametrize("size", [1, 5, 47, 1000])
def test_what_is_cut_off_at_first_is_no_damage_and_what_is_cut_out_later_is(size: int) -> None:
    data = PLAIN[20:] + PLAIN + WRAPPED[:-1] + PLAIN + WRAPPED[1:] + WRAPPED[:9] + PLAIN
    splitter = Splitter()
    for at in range(0, len(data), size):
        splitter.feed(data[at : at + size])
    assert splitter.bad == 3
    splitter.restart()
    assert splitter.feed(WRAPPED[3:] + PLAIN) == [decode(PLAIN)]
    assert splitter.bad == 3


def test_a_lost_byte_costs_that_packet_alone() -> None:
    """All but those of which the checksum misses it, one in 256."""
    missed = 0
    for lost in range(SIZE):
        shifted = WRAPPED[:lost] + WRAPPED[lost + 1 :]
        splitter = Splitter()
        found = splitter.feed(PLAIN + shifted + PLAIN + PLAIN)
        missed += decode(shifted + PLAIN[:1]) is not None
        assert found == [decode(PLAIN)] * 3 or decode(shifted + PLAIN[:1]) in found
    assert missed <= 1


def test_a_stray_first_byte_of_a_header_costs_nothing() -> None:
    splitter = Splitter()
    assert splitter.feed(b"\x54" + PLAIN + b"\x54\x54" + WRAPPED) == [
        decode(PLAIN),
        decode(WRAPPED),
    ]
    assert splitter.bad == 0


def test_memory_does_not_grow_with_what_is_no_packet() -> None:
    splitter = Splitter()
    for _ in range(100):
        assert splitter.feed(b"\xaa\x55\xf0\x0f" * 1000) == []
    assert len(splitter._rest) <= SIZE
    assert splitter.foreign == 100_000
