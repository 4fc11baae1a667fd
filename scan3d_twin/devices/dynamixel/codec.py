"""Bytes of Dynamixel protocol 2.0, for the emulator; the driver speaks through dynamixel-sdk.

A packet is ``FF FF FD 00 id len16 instruction params crc16``. The length counts the bytes after it.
Inside instruction and parameters each ``FF FF FD`` is followed by a stuffed ``FD``; length and
CRC are those of the stuffed packet. Source: the e-manual of Robotis, protocol 2.0.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

HEADER = b"\xff\xff\xfd\x00"
_RESERVED_SEQUENCE, _STUFFED_SEQUENCE = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_HEAD = struct.Struct("<4sBH")
CRC_SIZE = 2
MIN_LENGTH = 1 + CRC_SIZE
"""Length field of the shortest packet: an instruction and the CRC."""
MAX_LENGTH = 512
"""Largest length field that is accepted [bytes]; assumption: the whole table has 228 bytes."""
BROADCAST = 0xFE
"""Id that addresses all servos."""
ALERT = 0x80
"""Bit of the error byte: the register ``hardware error`` is not 0."""
POLYNOMIAL = 0x8005
"""Of the CRC-16, high bit first from 0, not reflected (CRC-16/UMTS)."""


class Instruction(IntEnum):
    """What a packet asks for."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    BULK_READ = 0x92
    BULK_WRITE = 0x93


class ErrorNumber(IntEnum):
    """Why a servo refuses an instruction: the error byte of a reply without its bit ``ALERT``."""

    NONE = 0
    FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet, without stuffing.

    Attributes:
        id: Id of the servo that it is for or from.
        instruction: One of ``Instruction``; another number is an unknown instruction.
        params: Parameters; of a status packet the error byte is the first.
    """

    id: int
    instruction: int
    params: bytes = b""

    def encode(self) -> bytes:
        """Return the bytes on the line."""
        body = bytes([self.instruction]) + self.params
        body = body.replace(_RESERVED_SEQUENCE, _STUFFED_SEQUENCE)
        data = _HEAD.pack(HEADER, self.id, len(body) + CRC_SIZE) + body
        return data + struct.pack("<H", crc16(data))


GROUP_INSTRUCTIONS = (
    Instruction.SYNC_READ,
    Instruction.SYNC_WRITE,
    Instruction.BULK_READ,
    Instruction.BULK_WRITE,
)
"""Instructions to several servos at once, each named in the parameters."""


@dataclass(frozen=True, slots=True)
class DamagedPacket:
    """A packet whose CRC is wrong.

    Attributes:
        id: Id as it arrived.
    """

    id: int


def _crc_of_byte(value: int) -> int:
    remainder = value << 8
    for _ in range(8):
        remainder = remainder << 1 ^ (POLYNOMIAL if remainder & 0x8000 else 0)
    return remainder & 0xFFFF


_CRC_TABLE = tuple(map(_crc_of_byte, range(256)))


def crc16(data: bytes) -> int:
    """Return the CRC-16 of ``data``; 0xFEE8 for ``b"123456789"``."""
    crc = 0
    for byte in data:
        crc = crc << 8 & 0xFFFF ^ _CRC_TABLE[crc >> 8 ^ byte]
    return crc


def encode_status(servo: int, error: int, data: bytes = b"") -> bytes:
    """Return the bytes of a reply of the servo with an id, with its error byte and ``data``."""
    return Packet(servo, Instruction.STATUS, bytes([error]) + data).encode()


class PacketSplitter:
    """Finds packets in bytes that are cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""

    def clear(self) -> None:
        """Forget a packet that is not complete."""
        self._rest = b""

    def feed(self, data: bytes) -> list[Packet | DamagedPacket]:
        """Return the packets that are complete now."""
        self._rest += data
        packets: list[Packet | DamagedPacket] = []
        while (start := self._rest.find(HEADER)) >= 0:
            # Wait for the whole packet
            self._rest = self._rest[start:]
            if len(self._rest) < _HEAD.size:
                return packets
            _, servo, length = _HEAD.unpack_from(self._rest)
            size = _HEAD.size + length
            if MIN_LENGTH <= length <= MAX_LENGTH and len(self._rest) < size:
                return packets

            # Check it; search on behind the header of a damaged one
            whole, is_good = self._rest[:size], False
            if MIN_LENGTH <= length <= MAX_LENGTH:
                is_good = crc16(whole[:-CRC_SIZE]) == int.from_bytes(whole[-CRC_SIZE:], "little")
                packets.append(_decode(servo, whole) if is_good else DamagedPacket(servo))
            self._rest = self._rest[size if is_good else len(HEADER) :]
        # A header may be cut
        self._rest = self._rest[-(len(HEADER) - 1) :]
        return packets


def _decode(servo: int, whole: bytes) -> Packet:
    """Return the packet of the bytes of a ``whole`` one."""
    body = whole[_HEAD.size : -CRC_SIZE].replace(_STUFFED_SEQUENCE, _RESERVED_SEQUENCE)
    return Packet(servo, body[0], body[1:])


def split_group(packet: Packet) -> list[Packet]:
    """Return what one of the ``GROUP_INSTRUCTIONS`` asks of each servo, in the order named.

    Returns:
        Packets to read or to write, as if each servo had been asked alone; what is left over at the
        end is ignored.
    """
    params = packet.params
    if packet.instruction == Instruction.SYNC_READ:
        return [Packet(servo, Instruction.READ, params[:4]) for servo in params[4:]]
    if packet.instruction == Instruction.BULK_READ:
        whole = range(0, len(params) - 4, 5)
        return [Packet(params[at], Instruction.READ, params[at + 1 : at + 5]) for at in whole]

    # Address and length once for all, or before the data of each
    is_sync = packet.instruction == Instruction.SYNC_WRITE
    head, at = (params[:4], 4) if is_sync else (b"", 0)
    packets = []
    while at < len(params):
        place = head or params[at + 1 : at + 5]
        begin = at + 1 if is_sync else at + 5
        end = begin + int.from_bytes(place[2:4], "little")
        if len(place) < 4 or end > len(params):
            break
        data = place[:2] + params[begin:end]
        packets.append(Packet(params[at], Instruction.WRITE, data))
        at = end
    return packets
