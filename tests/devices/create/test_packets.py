import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.devices.create.packets import (
    GROUPS,
    Packet,
    decode_packets,
    encode_packet,
    encode_packets,
    packets_of,
    size_of,
)

# Bytes per group: Create Open Interface page 17; Create 2 Open Interface, "Sensor Packets".
GROUP_SIZES = {0: 26, 1: 10, 2: 6, 3: 10, 4: 14, 5: 12, 6: 52, 100: 80, 101: 28, 106: 12, 107: 9}
TWO_BYTES = {19, 20, 22, 23, 25, 26, 27, 28, 29, 30, 31, 33, 39, 40, 41, 42, 43, 44}
TWO_BYTES |= {46, 47, 48, 49, 50, 51, 54, 55, 56, 57}
SIGNED = {19, 20, 23, 24, 39, 40, 41, 42, 54, 55, 56, 57}


@pytest.mark.parametrize(("group", "size"), GROUP_SIZES.items())
def test_groups_have_the_sizes_of_the_manuals(group, size):
    assert size_of(group) == size


def test_every_group_is_listed():
    assert set(GROUPS) == set(GROUP_SIZES)


@pytest.mark.parametrize("packet", range(7, 59))
def test_packets_have_the_sizes_and_signs_of_the_manuals(packet):
    size = 2 if packet in TWO_BYTES else 1
    assert size_of(packet) == size
    low = decode_packets([packet], b"\x80" + bytes(size - 1))[packet]
    assert low == (-1 if packet in SIGNED else 1) * (128 << 8 * (size - 1))


@pytest.mark.parametrize("number", [59, 99, 102, 105, 108, 255])
def test_an_unknown_packet_is_nothing(number):
    assert size_of(number) == 0
    assert not packets_of(number)


def test_values_are_big_endian():
    assert encode_packet(Packet.DISTANCE, -2) == b"\xff\xfe"
    assert encode_packet(Packet.LEFT_COUNTS, 0x1234) == b"\x12\x34"
    assert encode_packet(Packet.TEMPERATURE, -5) == b"\xfb"


def test_values_out_of_range_are_capped():
    assert encode_packet(Packet.DISTANCE, 40_000) == b"\x7f\xff"
    assert encode_packet(Packet.ANGLE, -40_000) == b"\x80\x00"
    assert encode_packet(Packet.MODE, 300) == b"\xff"
    assert encode_packet(Packet.CHARGE, -1) == b"\x00\x00"


def test_data_of_the_wrong_length_are_refused():
    with pytest.raises(ValueError, match="take 3 bytes, got 2"):
        decode_packets([Packet.MODE, Packet.LEFT_COUNTS], b"\x01\x02")


@given(st.lists(st.sampled_from([*range(7, 59), *GROUPS]), max_size=8), st.data())
def test_what_is_encoded_is_decoded(numbers, data):
    ids = {packet for number in numbers for packet in packets_of(number)}
    values = {
        packet: data.draw(
            st.integers(
                -(1 << 8 * size_of(packet) - 1) if packet in SIGNED else 0,
                (1 << 8 * size_of(packet) - (packet in SIGNED)) - 1,
            )
        )
        for packet in sorted(ids)
    }
    assert decode_packets(numbers, encode_packets(numbers, values)) == values
