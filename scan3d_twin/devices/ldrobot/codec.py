"""Packets of the LDROBOT lidars: bytes to values and back.

A packet has 47 bytes, low byte first: ``54 2C``, speed in deg/s, angle of the first reading in 0.01
deg, 12 readings of a distance in mm and an intensity, angle of the last reading, time in ms modulo
30 s, and a CRC-8 of what comes before it. Angles of the readings between are evenly spaced. Angles
grow clockwise seen from above, 0 is ahead. (LDROBOT development manuals; ldlidar_stl_ros2.)
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

HEADER = b"\x54\x2c"
READINGS = 12
"""Readings of a packet."""
FULL_TURN = 36_000
"""Angles of a turn [0.01 deg]."""
TIME_PERIOD = 30_000
"""Times begin again at 0 from here [ms]."""
POLYNOMIAL = 0x4D
"""Of the CRC-8, with start 0, not reflected; the check value of "123456789" is C3."""
MAX_STRAY = 2
"""Bytes between two packets that are inserted by a bad line rather than what is left of a packet;
assumption."""
FOREIGN_HEADER = b"\xaa\x55"
"""Begins the packets of a COIN-D4, which is sold as LD19 too."""
FOREIGN = "in another protocol (AA 55): a COIN-D4, which is sold as LD19 too; it is not supported"
MIN_FOREIGN, MIN_FOREIGN_SHARE = 3, 0.002
"""Headers of another protocol, and their share of the bytes, from which on it is that; two given
bytes are 0.000015 of random ones, its packets have at most 200 [assumption]."""

_PACKET = struct.Struct("<2sHH" + "HB" * READINGS + "HHB")
SIZE = _PACKET.size
"""Bytes of a packet: 47."""


def _make_table() -> bytes:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ (POLYNOMIAL if value & 0x80 else 0)
        table.append(value & 0xFF)
    return bytes(table)


_TABLE = _make_table()


def crc8(data: bytes) -> int:
    """Return the checksum of ``data``."""
    crc = 0
    for byte in data:
        crc = _TABLE[crc ^ byte]
    return crc


@dataclass(frozen=True, slots=True)
class Packet:
    """Twelve readings, one after the other.

    Attributes:
        speed: Turn rate [deg/s].
        start: Angle of the first reading [0.01 deg].
        end: Angle of the last reading [0.01 deg].
        time: Time of the last reading [ms], modulo ``TIME_PERIOD``.
        distances: [mm]; 0 where there is no valid return (12,).
        intensities: 0 to 255 (12,).
    """

    speed: int
    start: int
    end: int
    time: int
    distances: tuple[int, ...]
    intensities: tuple[int, ...]

    @property
    def span(self) -> int:
        """Angle from the first to the last reading [0.01 deg]."""
        return (self.end - self.start) % FULL_TURN


def encode(packet: Packet) -> bytes:
    """Return the bytes of ``packet``."""
    readings = (
        value for pair in zip(packet.distances, packet.intensities, strict=True) for value in pair
    )
    body = _PACKET.pack(HEADER, packet.speed, packet.start, *readings, packet.end, packet.time, 0)[
        :-1
    ]
    return body + bytes([crc8(body)])


def decode(data: bytes) -> Packet | None:
    """Return the packet in 47 bytes of ``data``; None if its header or checksum is wrong."""
    if data[:2] != HEADER or crc8(data[:-1]) != data[-1]:
        return None
    _, speed, start, *readings, end, time, _ = _PACKET.unpack(data)
    return Packet(speed, start, end, time, tuple(readings[::2]), tuple(readings[1::2]))


class Splitter:
    """Finds packets in bytes that are cut anywhere.

    Attributes:
        bad: Damaged packets, by the number of bytes between two good ones.
        passed: Bytes taken in.
        foreign: Headers of another maker's protocol among them.
    """

    def __init__(self) -> None:
        self.bad = 0
        self.passed = 0
        self.foreign = 0
        self._rest = b""
        self._skipped = 0
        self._is_cut = True

    @property
    def is_foreign(self) -> bool:
        """Whether what arrives is another maker's protocol."""
        return self.foreign >= max(MIN_FOREIGN, MIN_FOREIGN_SHARE * self.passed)

    def restart(self) -> None:
        """Forget the packet that has begun, after bytes were lost; its rest is no damage."""
        self._rest, self._skipped, self._is_cut = b"", 0, True

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete now.

        After a damaged packet the search goes on at its second byte: the next one is not lost. What
        comes before the first packet is the rest of one that began earlier.
        """
        self.passed += len(data)
        self.foreign += data.count(FOREIGN_HEADER)
        rest, at, packets = self._rest + data, 0, []
        while (start := rest.find(HEADER, at)) >= 0 and len(rest) - start >= SIZE:
            packet = decode(rest[start : start + SIZE])
            if packet is None:
                self._skipped += start + 1 - at
                at = start + 1
            else:
                self._count_damage(start - at)
                packets.append(packet)
                at = start + SIZE

        # Keep what may be the beginning of a packet
        kept = start if start >= 0 else max(at, len(rest) - len(HEADER) + 1)
        self._skipped += kept - at
        self._rest = rest[kept:]
        return packets

    def _count_damage(self, more: int) -> None:
        """Count the packets that were damaged before a good one, and ``more`` skipped bytes."""
        skipped = self._skipped + more
        if skipped > MAX_STRAY and not self._is_cut:
            self.bad += math.ceil((skipped - MAX_STRAY) / SIZE)
        self._skipped, self._is_cut = 0, False
