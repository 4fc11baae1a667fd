"""Bytes of Dynamixel protocol 2.0."""

import struct

import pytest
from dynamixel_sdk import PacketHandler
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.devices.dynamixel import codec
from scan3d_twin.devices.dynamixel.codec import (
    DamagedPacket,
    Instruction,
    Packet,
    PacketSplitter,
    crc16,
    encode_status,
    split_group,
)

EXAMPLES = {
    "ping": (Packet(1, 1), "FF FF FD 00 01 03 00 01 19 4E"),
    "torque on": (Packet(1, 3, b"\x40\x00\x01"), "FF FF FD 00 01 06 00 03 40 00 01 DB 66"),
    "mode 3": (Packet(1, 3, b"\x0b\x00\x03"), "FF FF FD 00 01 06 00 03 0B 00 03 48 E3"),
    "goal 1024": (
        Packet(1, 3, struct.pack("<HI", 116, 1024)),
        "FF FF FD 00 01 09 00 03 74 00 00 04 00 00 B2 89",
    ),
    "read position": (
        Packet(1, 2, struct.pack("<HH", 132, 4)),
        "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15",
    ),
    "return delay 0": (Packet(1, 3, b"\x09\x00\x00"), "FF FF FD 00 01 06 00 03 09 00 00 69 63"),
    "reply to ping": (
        Packet(1, 0x55, b"\x00" + struct.pack("<HB", 1200, 52)),
        "FF FF FD 00 01 07 00 55 00 B0 04 34 B2 D4",
    ),
    "reply 2048": (
        Packet(1, 0x55, b"\x00" + struct.pack("<I", 2048)),
        "FF FF FD 00 01 08 00 55 00 00 08 00 00 1C 38",
    ),
    "reply ok": (Packet(1, 0x55, b"\x00"), "FF FF FD 00 01 04 00 55 00 A1 0C"),
    "stuffed reply": (
        Packet(1, 0x55, b"\x00\xff\xff\xfd\x00"),
        "FF FF FD 00 01 09 00 55 00 FF FF FD FD 00 D8 9C",
    ),
}
"""Packets of the manual, and some exchanged with the maker's package (shared/reference)."""
PACKETS = st.builds(
    Packet,
    st.integers(0, 252),
    st.sampled_from(sorted(Instruction)),
    st.lists(st.sampled_from([0, 1, 0xFD, 0xFE, 0xFF]), max_size=40).map(bytes),
)
"""Packets that often hold what must be stuffed."""


class Sent:
    """A port of the SDK that keeps what is sent, and is read from what it is given."""

    is_using = False

    def __init__(self, received=b""):
        self.received = received

    def clearPort(self):  # noqa: N802
        pass

    def writePort(self, packet):  # noqa: N802
        self.sent = bytes(packet)
        return len(packet)

    def readPort(self, length):  # noqa: N802
        data, self.received = self.received[:length], self.received[length:]
        return list(data)

    def isPacketTimeout(self):  # noqa: N802
        return True


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_byte_by_byte(name):
    packet, text = EXAMPLES[name]
    assert packet.encode() == bytes.fromhex(text)
    assert PacketSplitter().feed(bytes.fromhex(text)) == [packet]


def test_the_crc_is_umts():
    assert crc16(b"123456789") == 0xFEE8


@given(st.lists(PACKETS, max_size=5), st.integers(1, 9))
@settings(max_examples=60, deadline=None)
def test_packets_are_found_however_they_are_cut(packets, size):
    data = b"".join(packet.encode() for packet in packets)
    splitter = PacketSplitter()
    found = [
        packet for at in range(0, len(data), size) for packet in splitter.feed(data[at : at + size])
    ]
    assert found == packets


@given(PACKETS)
@settings(max_examples=60, deadline=None)
def test_no_header_is_inside_a_packet(packet):
    assert packet.encode().rfind(codec.HEADER) == 0


@given(PACKETS.filter(lambda each: b"\xff\xff\xfd" not in bytes([each.instruction]) + each.params))
@settings(max_examples=60, deadline=None)
def test_the_sdk_of_the_maker_makes_the_same_bytes(packet):
    port = Sent()
    head = [0, 0, 0, 0, packet.id, *struct.pack("<H", len(packet.params) + 3), packet.instruction]
    assert PacketHandler(2.0).txPacket(port, [*head, *packet.params, 0, 0]) == 0
    assert port.sent == packet.encode()


def test_the_sdk_of_the_maker_reads_what_is_stuffed():
    data = bytes.fromhex("FFFFFD00FFFFFD01")
    read, result, error = PacketHandler(2.0).readRx(Sent(encode_status(1, 0, data)), 1, len(data))
    assert (bytes(read), result, error) == (data, 0, 0)


@pytest.mark.parametrize("at", range(16))
def test_a_flipped_bit_is_never_believed(at):
    data = bytearray(EXAMPLES["goal 1024"][0].encode())
    data[at] ^= 0x10
    found = PacketSplitter().feed(bytes(data))
    assert all(isinstance(each, DamagedPacket) for each in found)


def test_it_goes_on_after_what_is_damaged():
    good = EXAMPLES["ping"][0]
    damaged = bytearray(EXAMPLES["torque on"][0].encode())
    damaged[-1] ^= 1
    found = PacketSplitter().feed(b"\xff\xff\x00noise" + bytes(damaged) + good.encode())
    assert found == [DamagedPacket(1), good]
    endless = codec.HEADER + b"\x01\xff\xff"
    assert PacketSplitter().feed(endless + good.encode()) == [good]


def test_instructions_to_several_servos():
    place = struct.pack("<HH", 116, 2)
    assert split_group(Packet(254, Instruction.SYNC_READ, place + b"\x01\x05")) == [
        Packet(1, Instruction.READ, place),
        Packet(5, Instruction.READ, place),
    ]
    writes = [
        Packet(1, Instruction.WRITE, b"\x74\x00ab"),
        Packet(5, Instruction.WRITE, b"\x74\x00cd"),
    ]
    params = place + b"\x01ab\x05cd"
    assert split_group(Packet(254, Instruction.SYNC_WRITE, params)) == writes
    params = b"\x01" + place + b"ab\x05" + place + b"cd"
    assert split_group(Packet(254, Instruction.BULK_WRITE, params)) == writes
    assert split_group(Packet(254, Instruction.BULK_WRITE, params[:-1])) == writes[:1]
    params = b"\x01" + place + b"\x05" + struct.pack("<HH", 7, 1)
    assert split_group(Packet(254, Instruction.BULK_READ, params)) == [
        Packet(1, Instruction.READ, place),
        Packet(5, Instruction.READ, struct.pack("<HH", 7, 1)),
    ]
