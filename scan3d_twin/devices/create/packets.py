"""Sensor packets of the iRobot Open Interface: ids, sizes, groups, encoding and decoding.

Sources: iRobot Create Open Interface (2007), pages 17 to 21 (packets 7 to 42, groups 0 to 6);
iRobot Create 2 Open Interface based on the Roomba 600 (2016), "Sensor Packets" (43 to 58, 100 to
107).

All values are big-endian and in the manuals' units (mm, deg, mV, mA, mAh).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum, IntFlag


class Packet(IntEnum):
    """Packet ids."""

    BUMPS_DROPS = 7
    WALL = 8
    CLIFF_LEFT = 9
    CLIFF_FRONT_LEFT = 10
    CLIFF_FRONT_RIGHT = 11
    CLIFF_RIGHT = 12
    VIRTUAL_WALL = 13
    OVERCURRENTS = 14
    DIRT = 15
    UNUSED = 16
    IR_OMNI = 17
    BUTTONS = 18
    DISTANCE = 19
    ANGLE = 20
    CHARGING_STATE = 21
    VOLTAGE = 22
    CURRENT = 23
    TEMPERATURE = 24
    CHARGE = 25
    CAPACITY = 26
    WALL_SIGNAL = 27
    CLIFF_LEFT_SIGNAL = 28
    CLIFF_FRONT_LEFT_SIGNAL = 29
    CLIFF_FRONT_RIGHT_SIGNAL = 30
    CLIFF_RIGHT_SIGNAL = 31
    DIGITAL_INPUTS = 32
    ANALOG_INPUT = 33
    CHARGING_SOURCES = 34
    MODE = 35
    SONG_NUMBER = 36
    SONG_PLAYING = 37
    STREAM_PACKETS = 38
    REQUESTED_VELOCITY = 39
    REQUESTED_RADIUS = 40
    REQUESTED_RIGHT = 41
    REQUESTED_LEFT = 42
    LEFT_COUNTS = 43
    RIGHT_COUNTS = 44
    LIGHT_BUMPER = 45
    LIGHT_LEFT_SIGNAL = 46
    LIGHT_FRONT_LEFT_SIGNAL = 47
    LIGHT_CENTRE_LEFT_SIGNAL = 48
    LIGHT_CENTRE_RIGHT_SIGNAL = 49
    LIGHT_FRONT_RIGHT_SIGNAL = 50
    LIGHT_RIGHT_SIGNAL = 51
    IR_LEFT = 52
    IR_RIGHT = 53
    LEFT_CURRENT = 54
    RIGHT_CURRENT = 55
    MAIN_BRUSH_CURRENT = 56
    SIDE_BRUSH_CURRENT = 57
    STASIS = 58


class BumpsDrops(IntFlag):
    """Bits of packet 7; only the Create 1 has a caster switch."""

    BUMP_RIGHT = 1
    BUMP_LEFT = 2
    DROP_RIGHT = 4
    DROP_LEFT = 8
    DROP_CASTER = 16


class Overcurrents(IntFlag):
    """Bits of packet 14 for the wheels, the same in both generations."""

    RIGHT_WHEEL = 8
    LEFT_WHEEL = 16


class ChargingSources(IntFlag):
    """Bits of packet 34."""

    INTERNAL = 1
    HOME_BASE = 2


class DockSignal(IntFlag):
    """Bits of packets 17, 52 and 53 while a dock is seen; fawkes roomba_500.h, Create 2 manual.

    ``BASE`` alone is reserved. Docks of the Roomba Discovery have 240 in its place, and 8, 4 and 2.
    """

    FORCE_FIELD = 1
    GREEN_BUOY = 4
    RED_BUOY = 8
    BASE = 160


class Mode(IntEnum):
    """Values of packet 35."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


_SIGNED = {19, 20, 23, 24, 39, 40, 41, 42, 54, 55, 56, 57}
_TWO_BYTES = {19, 20, 22, 23, *range(25, 32), 33, *range(39, 45), *range(46, 52), *range(54, 58)}

GROUPS: Mapping[int, range] = {
    0: range(7, 27),
    1: range(7, 17),
    2: range(17, 21),
    3: range(21, 27),
    4: range(27, 35),
    5: range(35, 43),
    6: range(7, 43),
    100: range(7, 59),
    101: range(43, 59),
    106: range(46, 52),
    107: range(54, 59),
}
"""Packet ids by group id."""


def packets_of(number: int) -> range:
    """Return the packets in ``number``, the id of a packet or group; empty if unknown."""
    if number in GROUPS:
        return GROUPS[number]
    return range(number, number + 1) if 7 <= number <= 58 else range(0)


def size_of(number: int) -> int:
    """Return the size of the packet or group ``number`` [bytes]; 0 if unknown."""
    return sum(2 if packet in _TWO_BYTES else 1 for packet in packets_of(number))


def encode_packet(packet: int, value: int) -> bytes:
    """Return the data of one packet; values out of range saturate, as on the base."""
    bits = 8 * size_of(packet)
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1) if packet in _SIGNED else (0, (1 << bits) - 1)
    )
    return min(max(value, low), high).to_bytes(bits // 8, "big", signed=packet in _SIGNED)


def encode_packets(numbers: Iterable[int], values: Mapping[int, int]) -> bytes:
    """Return the concatenated data of packets and groups."""
    return b"".join(encode_packet(p, values.get(p, 0)) for n in numbers for p in packets_of(n))


def decode_packets(numbers: Sequence[int], data: bytes) -> dict[int, int]:
    """Return the values of packets and groups by packet id.

    Raises:
        ValueError: ``data`` does not have the size of these packets.
    """
    wanted = sum(map(size_of, numbers))
    if len(data) != wanted:
        raise ValueError(f"packets {list(numbers)} take {wanted} bytes, got {len(data)}")
    values, place = {}, 0
    for number in numbers:
        for packet in packets_of(number):
            end = place + size_of(packet)
            values[packet] = int.from_bytes(data[place:end], "big", signed=packet in _SIGNED)
            place = end
    return values
