"""The Open Interface by its manuals: iRobot Create (2007) and iRobot Create 2 (2016)."""

import pytest

from scan3d_twin.devices.create.codec import BAUD_CODES, CREATE1, CREATE2, MODELS, CommandParser
from scan3d_twin.devices.create.packets import (
    GROUPS,
    BumpsDrops,
    ChargingSources,
    Mode,
    Overcurrents,
    Packet,
    decode_packets,
    size_of,
)

BOTH = {
    **{128: 0, 129: 1, 130: 0, 131: 0, 132: 0, 134: 0, 135: 0, 137: 4, 138: 1, 139: 3, 141: 1},
    **{142: 1, 143: 0, 144: 3, 145: 4, 150: 1},
}
"""Data bytes by opcode; those of 140, 148, 149 and 152 depend on a count."""
ONLY_1 = {136: 1, 147: 1, 151: 1, 153: 0, 154: 0, 155: 1, 156: 2, 157: 2, 158: 1}
ONLY_2 = {
    **{7: 0, 133: 0, 136: 0, 146: 4, 162: 2, 163: 4, 164: 4, 165: 1, 167: 15, 168: 3, 173: 0},
}
FILLER = 1
"""No opcode, so that a command that took too many bytes would be missed."""


@pytest.mark.parametrize(
    ("model", "opcodes"), [(CREATE1, BOTH | ONLY_1), (CREATE2, BOTH | ONLY_2)], ids=["1", "2"]
)
def test_every_command_takes_the_data_bytes_of_the_manual(model, opcodes):
    for opcode, count in opcodes.items():
        stream = bytes([opcode, *[FILLER] * count])
        first, second = CommandParser(model).feed(stream + stream)
        assert bytes(first) == bytes(second) == stream, opcode


@pytest.mark.parametrize("opcode", [140, 148, 149, 152])
def test_commands_with_a_count_take_as_many(opcode):
    for count in (1, 3):
        notes = [FILLER] * (2 * count if opcode == 140 else count)
        head = [opcode, FILLER, count] if opcode == 140 else [opcode, count]
        stream = bytes([*head, *notes])
        first, second = CommandParser(CREATE1).feed(stream + stream)
        assert bytes(first) == bytes(second) == stream


def test_what_only_the_other_generation_knows_is_skipped():
    for model, others in ((CREATE1, ONLY_2), (CREATE2, ONLY_1)):
        # 7 is not in the manual of the Create 1, whose firmware resets (turtlebot_create).
        for opcode in set(others) - {7, 136}:
            assert CommandParser(model).feed(bytes([opcode])) == []
    assert [each.op for each in CommandParser(CREATE1).feed(bytes([7]))] == [7]


PACKETS = """
7 BUMPS_DROPS 1, 8 WALL 1, 9 CLIFF_LEFT 1, 10 CLIFF_FRONT_LEFT 1, 11 CLIFF_FRONT_RIGHT 1,
12 CLIFF_RIGHT 1, 13 VIRTUAL_WALL 1, 14 OVERCURRENTS 1, 15 DIRT 1, 16 UNUSED 1, 17 IR_OMNI 1,
18 BUTTONS 1, 19 DISTANCE -2, 20 ANGLE -2, 21 CHARGING_STATE 1, 22 VOLTAGE 2, 23 CURRENT -2,
24 TEMPERATURE -1, 25 CHARGE 2, 26 CAPACITY 2, 27 WALL_SIGNAL 2, 28 CLIFF_LEFT_SIGNAL 2,
29 CLIFF_FRONT_LEFT_SIGNAL 2, 30 CLIFF_FRONT_RIGHT_SIGNAL 2, 31 CLIFF_RIGHT_SIGNAL 2,
32 DIGITAL_INPUTS 1, 33 ANALOG_INPUT 2, 34 CHARGING_SOURCES 1, 35 MODE 1, 36 SONG_NUMBER 1,
37 SONG_PLAYING 1, 38 STREAM_PACKETS 1, 39 REQUESTED_VELOCITY -2, 40 REQUESTED_RADIUS -2,
41 REQUESTED_RIGHT -2, 42 REQUESTED_LEFT -2, 43 LEFT_COUNTS 2, 44 RIGHT_COUNTS 2,
45 LIGHT_BUMPER 1, 46 LIGHT_LEFT_SIGNAL 2, 47 LIGHT_FRONT_LEFT_SIGNAL 2,
48 LIGHT_CENTRE_LEFT_SIGNAL 2, 49 LIGHT_CENTRE_RIGHT_SIGNAL 2, 50 LIGHT_FRONT_RIGHT_SIGNAL 2,
51 LIGHT_RIGHT_SIGNAL 2, 52 IR_LEFT 1, 53 IR_RIGHT 1, 54 LEFT_CURRENT -2, 55 RIGHT_CURRENT -2,
56 MAIN_BRUSH_CURRENT -2, 57 SIDE_BRUSH_CURRENT -2, 58 STASIS 1
"""
"""Id, name and bytes; negative where the value is signed."""


def test_every_packet_has_the_id_the_size_and_the_sign_of_the_manual():
    rows = [row.split() for row in PACKETS.replace("\n", " ").split(",")]
    assert [int(number) for number, _, _ in rows] == list(map(int, Packet))
    for number, name, size in rows:
        packet, bits = Packet[name], 8 * abs(int(size))
        assert (int(packet), size_of(packet)) == (int(number), bits // 8)
        (value,) = decode_packets([packet], bytes([0xFF] * (bits // 8))).values()
        assert value == (-1 if int(size) < 0 else (1 << bits) - 1)


def test_groups_are_those_of_the_manual():
    sizes = {0: 26, 1: 10, 2: 6, 3: 10, 4: 14, 5: 12, 6: 52, 100: 80, 101: 28, 106: 12, 107: 9}
    assert {group: size_of(group) for group in GROUPS} == sizes
    firsts = {0: 7, 1: 7, 2: 17, 3: 21, 4: 27, 5: 35, 6: 7, 100: 7, 101: 43, 106: 46, 107: 54}
    assert {group: packets[0] for group, packets in GROUPS.items()} == firsts
    assert [size_of(number) for number in (59, 99, 102, 255)] == [0, 0, 0, 0]


def test_bits_and_modes():
    assert [int(bit) for bit in BumpsDrops] == [1, 2, 4, 8, 16]
    assert (Overcurrents.RIGHT_WHEEL, Overcurrents.LEFT_WHEEL) == (8, 16)
    assert (ChargingSources.INTERNAL, ChargingSources.HOME_BASE) == (1, 2)
    assert [mode.name for mode in (Mode(0), Mode(1), Mode(2), Mode(3))] == [
        "OFF", "PASSIVE", "SAFE", "FULL",
    ]  # fmt: skip


def test_the_two_generations():
    assert [(m.baud, m.songs, max(m.packets)) for m in (CREATE1, CREATE2)] == [
        (57600, 16, 42),
        (115200, 5, 107),
    ]
    assert set(MODELS) == {"create1", "create2"}
    assert CREATE2.mm_per_count == pytest.approx(0.44456, abs=1e-5)
    assert dict(enumerate(BAUD_CODES)) == {
        **{0: 300, 1: 600, 2: 1200, 3: 2400, 4: 4800, 5: 9600, 6: 14400, 7: 19200, 8: 28800},
        **{9: 38400, 10: 57600, 11: 115200},
    }
