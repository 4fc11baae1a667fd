"""Requests to an RPLIDAR and its single replies: bytes to values and back.

Sources: Slamtec, "RPLIDAR Interface Protocol and Application Notes" (rev. 1.1), "the protocol"
below, and the headers of Slamtec's SDK 2.1.0 for the requests that it leaves out. All numbers are
little-endian. What follows the descriptor of a scan is in ``capsules`` and ``nodes``.
"""

from __future__ import annotations

import operator
import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import reduce
from typing import Any

from scan3d_twin.core.errors import ProtocolError

REQUEST_START = 0xA5
REPLY_START = b"\xa5\x5a"
HAS_PAYLOAD = 0x80
"""Bit of a command after which length, payload and checksum follow."""
MAX_LENGTH = (1 << 30) - 1
"""Longest reply that a descriptor can announce [bytes]."""
DESCRIPTOR_LENGTH = 7
INFO_LENGTH = 20
"""Length of the reply to GET_INFO without its descriptor [bytes]."""
MAX_REQUEST = 4 + 255
"""Longest request: start, command, length, payload, checksum [bytes]."""


class Command(IntEnum):
    """Commands; those from 0x80 on have a payload."""

    STOP = 0x25
    RESET = 0x40
    SCAN = 0x20
    FORCE_SCAN = 0x21
    GET_INFO = 0x50
    GET_HEALTH = 0x52
    GET_SAMPLERATE = 0x59
    EXPRESS_SCAN = 0x82
    GET_LIDAR_CONF = 0x84
    SET_MOTOR_RPM = 0xA8
    SET_MOTOR_PWM = 0xF0
    GET_ACC_BOARD_FLAG = 0xFF


class ReplyType(IntEnum):
    """Last byte of a descriptor: what follows it."""

    INFO = 0x04
    HEALTH = 0x06
    SAMPLERATE = 0x15
    LIDAR_CONF = 0x20
    NODES = 0x81
    EXPRESS = 0x82
    DENSE = 0x85
    ACC_BOARD_FLAG = 0xFF


class ConfKey(IntEnum):
    """Entries of GET_LIDAR_CONF."""

    WANTED_SPEED = 0x01
    MIN_RPM = 0x04
    MAX_RPM = 0x05
    MODE_COUNT = 0x70
    MODE_US_PER_SAMPLE = 0x71
    MODE_MAX_DISTANCE = 0x74
    MODE_REPLY_TYPE = 0x75
    TYPICAL_MODE = 0x7C
    MODE_NAME = 0x7F


FIXED_POINT = 256
"""Units per microsecond and per metre of the values of GET_LIDAR_CONF."""


def xor(data: bytes | bytearray) -> int:
    """Return the exclusive or of all bytes, the protocol's only checksum."""
    return reduce(operator.xor, data, 0)


def encode_request(command: int, payload: bytes = b"") -> bytes:
    """Return the bytes of a request; a payload is sent only with the commands that have one."""
    head = bytes([REQUEST_START, command])
    if not command & HAS_PAYLOAD:
        return head
    body = head + bytes([len(payload)]) + payload
    return body + bytes([xor(body)])


def encode_express_scan(mode: int) -> bytes:
    """Return the request for the scan mode ``mode``; 0 is the express scan of all firmwares."""
    return encode_request(Command.EXPRESS_SCAN, struct.pack("<BHH", mode, 0, 0))


def encode_conf_request(key: int, mode: int | None = None) -> bytes:
    """Return the request for an entry of the configuration, of a scan ``mode`` where it has one."""
    payload = struct.pack("<I", key) + (b"" if mode is None else struct.pack("<H", mode))
    return encode_request(Command.GET_LIDAR_CONF, payload)


def encode_motor_rpm(rpm: int) -> bytes:
    """Return the request that turns the motor of an S series lidar at ``rpm`` [1/min]; 0 stops."""
    return encode_request(Command.SET_MOTOR_RPM, struct.pack("<H", rpm))


@dataclass(frozen=True, slots=True)
class Request:
    """A request as the lidar receives it."""

    command: int
    payload: bytes = b""


class RequestSplitter:
    """Finds requests in bytes that are cut anywhere; those with a wrong checksum are dropped.

    Attributes:
        bad: Number of requests dropped.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.bad = 0

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests completed by ``data``."""
        self._rest += data
        requests: list[Request] = []
        while (start := self._rest.find(REQUEST_START)) >= 0:
            self._rest = self._rest[start:]
            length = self._length()
            if len(self._rest) < length:
                return requests
            body = self._rest[:length]
            if length > 2 and xor(body[:-1]) != body[-1]:
                self.bad += 1
                self._rest = self._rest[1:]
                continue
            requests.append(Request(body[1], body[3:-1] if length > 2 else b""))
            self._rest = self._rest[length:]
        self._rest = b""
        return requests

    @property
    def is_waiting(self) -> bool:
        """Whether a request has begun that is not complete."""
        return bool(self._rest)

    def reset(self) -> None:
        """Discard the request that is not complete."""
        self._rest = b""

    def _length(self) -> int:
        """Return the length of the request at the start of the buffer, as far as it is known."""
        if len(self._rest) < 2 or not self._rest[1] & HAS_PAYLOAD:
            return 2
        return 4 + (self._rest[2] if len(self._rest) > 2 else 0)


@dataclass(frozen=True, slots=True)
class Descriptor:
    """What precedes each reply.

    Attributes:
        length: Length of what follows, or of each of its frames [bytes].
        is_stream: Whether frames follow until STOP, instead of one reply.
        type: What follows, see ``ReplyType``.
    """

    length: int
    is_stream: bool
    type: int

    def encode(self) -> bytes:
        """Return the bytes of the descriptor."""
        word = self.length | int(self.is_stream) << 30
        return REPLY_START + struct.pack("<IB", word, self.type)


def decode_descriptor(data: bytes) -> Descriptor:
    """Return the descriptor in 7 bytes.

    Raises:
        ProtocolError: It is none.
    """
    if len(data) != DESCRIPTOR_LENGTH or data[:2] != REPLY_START:
        raise ProtocolError(f"not a descriptor: {data[:DESCRIPTOR_LENGTH].hex(' ')}")
    word, kind = struct.unpack("<IB", data[2:])
    if word >> 30 > 1:
        raise ProtocolError(f"unknown kind of reply in {data.hex(' ')}")
    return Descriptor(word & MAX_LENGTH, bool(word >> 30), kind)


def encode_reply(kind: ReplyType, payload: bytes) -> bytes:
    """Return a single reply with its descriptor."""
    return Descriptor(len(payload), False, kind).encode() + payload


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """The reply to GET_INFO.

    Attributes:
        model: Model byte; the high nibble is the major id.
        firmware: Major and minor version.
        hardware: Hardware revision.
        serial: Serial number, 16 bytes.
    """

    model: int
    firmware: tuple[int, int]
    hardware: int
    serial: bytes

    @property
    def major_id(self) -> int:
        """Series of the model: 1 is an A1, 4 a C1, 7 an S2."""
        return self.model >> 4

    def encode(self) -> bytes:
        """Return the payload."""
        major, minor = self.firmware
        return bytes([self.model, minor, major, self.hardware]) + self.serial


def decode_info(payload: bytes) -> DeviceInfo:
    """Return the lidar's description of itself.

    Raises:
        ProtocolError: The payload has another length.
    """
    model, minor, major, hardware, serial = _unpack("<BBBB16s", payload, "device information")
    return DeviceInfo(model, (major, minor), hardware, serial)


GOOD, WARNING, ERROR = 0, 1, 2
"""Health status; after an error only RESET ends the protection stop."""


@dataclass(frozen=True, slots=True)
class Health:
    """The reply to GET_HEALTH: status and, low byte first, the maker's error code."""

    status: int
    code: int = 0

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack("<BH", self.status, self.code)


def decode_health(payload: bytes) -> Health:
    """Return the health.

    Raises:
        ProtocolError: The payload has another length, or the status is unknown.
    """
    status, code = _unpack("<BH", payload, "health")
    if status > ERROR:
        raise ProtocolError(f"unknown health status {status}")
    return Health(status, code)


@dataclass(frozen=True, slots=True)
class SampleRate:
    """The reply to GET_SAMPLERATE: time per sample of standard and express scan [us]."""

    standard_us: int
    express_us: int

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack("<HH", self.standard_us, self.express_us)


def decode_sample_rate(payload: bytes) -> SampleRate:
    """Return the times per sample.

    Raises:
        ProtocolError: The payload has another length, or a time is 0.
    """
    standard, express = _unpack("<HH", payload, "sample rate")
    if not (standard and express):
        raise ProtocolError("a sample takes 0 us")
    return SampleRate(standard, express)


def decode_conf_request(payload: bytes) -> tuple[int, int]:
    """Return (key, scan mode) of a request for an entry of the configuration; mode 0 if none.

    Raises:
        ProtocolError: The payload is too short.
    """
    if len(payload) < 4:
        raise ProtocolError("a request for the configuration without its key")
    (key,) = struct.unpack("<I", payload[:4])
    return key, struct.unpack("<H", payload[4:6])[0] if len(payload) >= 6 else 0


def encode_conf_reply(key: int, value: bytes) -> bytes:
    """Return the payload of the reply to GET_LIDAR_CONF: the key again and the value."""
    return struct.pack("<I", key) + value


def decode_conf_reply(payload: bytes, key: int) -> bytes:
    """Return the value of the entry ``key``.

    Raises:
        ProtocolError: It is the reply to another key.
    """
    if len(payload) < 4 or struct.unpack("<I", payload[:4])[0] != key:
        raise ProtocolError(f"not the entry {key:#x} of the configuration: {payload.hex(' ')}")
    return payload[4:]


def decode_number(value: bytes) -> int:
    """Return the number in a ``value`` of 1, 2 or 4 bytes.

    Raises:
        ProtocolError: It has another length.
    """
    if len(value) not in (1, 2, 4):
        raise ProtocolError(f"not a number: {value.hex(' ')}")
    return int.from_bytes(value, "little")


def decode_name(value: bytes) -> str:
    """Return the text before the NUL in ``value``.

    Raises:
        ProtocolError: It is not printable ASCII.
    """
    text = value.partition(b"\0")[0].decode("latin-1")
    if not (text.isascii() and text.isprintable()):
        raise ProtocolError(f"not a name: {value.hex(' ')}")
    return text


def _unpack(layout: str, payload: bytes, what: str) -> tuple[Any, ...]:
    if len(payload) != struct.calcsize(layout):
        raise ProtocolError(f"{what} of {len(payload)} bytes, not {struct.calcsize(layout)}")
    return struct.unpack(layout, payload)
