"""The iRobot Open Interface in both directions, as bytes: commands and sensor streams.

Sources: iRobot Create Open Interface (2007; "Create 1" below, page numbers are its own) and iRobot
Create 2 Open Interface based on the Roomba 600 (2016; "Create 2"). Nothing here does I/O: the
parsers accept bytes in pieces of any size and return what is complete.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from scan3d_twin.devices.create.packets import decode_packets, encode_packets, size_of
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE

BAUD_CODES = (300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 115200)
"""Baud rates, indexed by the code of command 129 [bit/s]; page 8."""
PERIOD = 0.015
"""Time between two sensor updates, and between two stream frames [s]; page 14."""
MAX_WHEEL_SPEED_MM = 500
"""Largest wheel speed [mm/s]; page 10."""
STRAIGHT = (0x7FFF, -0x8000)
"""Radii of command 137 that stand for a straight line; page 9."""
HEADER = 19
"""First byte of a stream frame; page 14."""
MAX_SCRIPT = 100
"""Longest script [bytes]; page 15."""


class Op(IntEnum):
    """Opcodes."""

    RESET = 7
    START = 128
    BAUD = 129
    CONTROL = 130
    SAFE = 131
    FULL = 132
    POWER = 133
    SPOT = 134
    CLEAN = 135
    DEMO = 136
    DRIVE = 137
    LOW_SIDE_DRIVERS = 138
    LEDS = 139
    SONG = 140
    PLAY = 141
    SENSORS = 142
    DOCK = 143
    PWM_LOW_SIDE_DRIVERS = 144
    DRIVE_DIRECT = 145
    DRIVE_PWM = 146
    DIGITAL_OUTPUTS = 147
    STREAM = 148
    QUERY_LIST = 149
    PAUSE_RESUME = 150
    SEND_IR = 151
    SCRIPT = 152
    PLAY_SCRIPT = 153
    SHOW_SCRIPT = 154
    WAIT_TIME = 155
    WAIT_DISTANCE = 156
    WAIT_ANGLE = 157
    WAIT_EVENT = 158
    SCHEDULING_LEDS = 162
    DIGIT_LEDS_RAW = 163
    DIGIT_LEDS_ASCII = 164
    PUSH_BUTTONS = 165
    SCHEDULE = 167
    SET_DAY_TIME = 168
    STOP = 173


_COMMON = {
    Op.RESET: 0, Op.START: 0, Op.BAUD: 1, Op.CONTROL: 0, Op.SAFE: 0, Op.FULL: 0, Op.SPOT: 0,
    Op.CLEAN: 0, Op.DRIVE: 4, Op.LOW_SIDE_DRIVERS: 1, Op.LEDS: 3, Op.SONG: 2, Op.PLAY: 1,
    Op.SENSORS: 1, Op.DOCK: 0, Op.PWM_LOW_SIDE_DRIVERS: 3, Op.DRIVE_DIRECT: 4, Op.STREAM: 1,
    Op.QUERY_LIST: 1, Op.PAUSE_RESUME: 1,
}  # fmt: skip
_CREATE1 = {
    Op.DEMO: 1, Op.DIGITAL_OUTPUTS: 1, Op.SEND_IR: 1, Op.SCRIPT: 1, Op.PLAY_SCRIPT: 0,
    Op.SHOW_SCRIPT: 0, Op.WAIT_TIME: 1, Op.WAIT_DISTANCE: 2, Op.WAIT_ANGLE: 2, Op.WAIT_EVENT: 1,
}  # fmt: skip
_CREATE2 = {
    Op.POWER: 0, Op.DEMO: 0, Op.DRIVE_PWM: 4, Op.SCHEDULING_LEDS: 2,
    Op.DIGIT_LEDS_RAW: 4, Op.DIGIT_LEDS_ASCII: 4, Op.PUSH_BUTTONS: 1, Op.SCHEDULE: 15,
    Op.SET_DAY_TIME: 3, Op.STOP: 0,
}  # fmt: skip
_VARIABLE = {Op.SONG: 2, Op.STREAM: 1, Op.QUERY_LIST: 1, Op.SCRIPT: 1}
"""Commands of variable length: bytes per item; the last fixed data byte is the number of items."""


@dataclass(frozen=True, slots=True)
class Model:
    """One generation of the base.

    Attributes:
        name: For example ``create2``.
        baud: Baud rate after power-on [bit/s].
        packets: Ids of the supported packets and packet groups.
        opcodes: Number of fixed data bytes, by opcode.
        wheel_base_mm: Distance between the wheels [mm].
        wheel_diameter_mm: Diameter of a wheel [mm].
        counts_per_turn: Encoder counts per wheel turn; 0 where packets 43 and 44 do not exist.
        songs: Number of songs it can store.
        radius_mm: Radius of the round body [mm].
        min_speed_mm: Speed of the faster wheel below which it may not turn at all [mm/s].
    """

    name: str
    baud: int
    packets: frozenset[int]
    opcodes: dict[Op, int]
    wheel_base_mm: float
    wheel_diameter_mm: float
    counts_per_turn: float
    songs: int
    radius_mm: float = 165.0  # create_robot URDF; both generations
    min_speed_mm: float = 0.0

    @property
    def has_counts(self) -> bool:
        """Whether it has encoder counts, as the Create 2 and the Roomba since the 500 have."""
        return self.counts_per_turn > 0

    @property
    def mm_per_count(self) -> float:
        """Distance rolled per encoder count [mm]."""
        return math.pi * self.wheel_diameter_mm / self.counts_per_turn


CREATE1 = Model(
    "create1",
    57600,  # page 5
    frozenset(range(43)),
    _COMMON | _CREATE1,
    wheel_base_mm=258.0,  # libcreate types.cpp, as the next
    wheel_diameter_mm=78.0,
    counts_per_turn=0.0,
    songs=16,
)
CREATE2 = Model(
    "create2",
    115200,  # "Serial Port Settings"
    frozenset({*range(59), 100, 101, 106, 107}),
    _COMMON | _CREATE2,
    wheel_base_mm=235.0,  # "Sensor Packets", angle (id 20)
    wheel_diameter_mm=72.0,  # "Sensor Packets", left encoder counts (id 43), as the next
    counts_per_turn=508.8,
    songs=5,
)
MODELS = {model.name: model for model in (CREATE1, CREATE2)}


@dataclass(frozen=True, slots=True)
class Command:
    """One command: its opcode and its data bytes, including any count byte."""

    op: Op
    data: bytes = b""

    def __bytes__(self) -> bytes:
        return bytes([self.op]) + self.data

    def words(self) -> tuple[int, ...]:
        """Return the data as signed big-endian 16-bit numbers."""
        pairs = (self.data[k : k + 2] for k in range(0, len(self.data), 2))
        return tuple(int.from_bytes(pair, "big", signed=True) for pair in pairs)


def command(op: Op, *data: int) -> bytes:
    """Return a command with data bytes ``data``."""
    return bytes(Command(op, bytes(data)))


def drive(velocity_mm: int, radius_mm: int) -> bytes:
    """Return command 137: drive at a mean wheel speed [mm/s] on a radius [mm]; page 9."""
    return bytes(Command(Op.DRIVE, _words(velocity_mm, radius_mm)))


def drive_direct(right_mm: int, left_mm: int) -> bytes:
    """Return command 145: set the speeds of the right and the left wheel [mm/s]; page 10.

    Raises:
        ValueError: A speed is beyond +-500 mm/s.
    """
    if max(abs(right_mm), abs(left_mm)) > MAX_WHEEL_SPEED_MM:
        raise ValueError(f"wheel speeds must be within +-500 mm/s, got {right_mm} and {left_mm}")
    return bytes(Command(Op.DRIVE_DIRECT, _words(right_mm, left_mm)))


def sensors(packet: int) -> bytes:
    """Return command 142: request one packet or group once; page 13."""
    return command(Op.SENSORS, packet)


def query(packets: Sequence[int]) -> bytes:
    """Return command 149: request the data of ``packets`` once; page 13."""
    return command(Op.QUERY_LIST, len(packets), *packets)


def stream(packets: Sequence[int]) -> bytes:
    """Return command 148: request ``packets`` every 15 ms; page 14."""
    return command(Op.STREAM, len(packets), *packets)


def script(commands: bytes) -> bytes:
    """Return command 152: store a script made of complete commands; page 15.

    Raises:
        ValueError: The script is longer than 100 bytes.
    """
    if len(commands) > MAX_SCRIPT:
        raise ValueError(f"a script holds {MAX_SCRIPT} bytes, got {len(commands)}")
    return command(Op.SCRIPT, len(commands), *commands)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "big", signed=True) for value in values)


class CommandParser:
    """The base's side of the line: bytes in, complete commands out.

    Attributes:
        skipped: Bytes skipped because they are no known opcode.
    """

    def __init__(self, model: Model) -> None:
        self.skipped = 0
        self._opcodes = model.opcodes
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Take in ``data`` and return the commands that are now complete."""
        self._buffer += data
        commands = []
        while self._buffer:
            # Skip what is no opcode
            op = self._buffer[0]
            if op not in self._opcodes:
                del self._buffer[0]
                self.skipped += 1
                continue

            # Cut off one complete command
            end = self._end(Op(op))
            if len(self._buffer) < end:
                break
            commands.append(Command(Op(op), bytes(self._buffer[1:end])))
            del self._buffer[:end]
        return commands

    def reset(self) -> None:
        """Discard an incomplete command."""
        self._buffer.clear()

    def _end(self, op: Op) -> int:
        """Return the length of the command at the start of the buffer, as far as known yet."""
        fixed = 1 + self._opcodes[op]
        if op not in _VARIABLE or len(self._buffer) < fixed:
            return fixed
        return fixed + _VARIABLE[op] * self._buffer[fixed - 1]


def encode_frame(packets: Sequence[int], values: dict[int, int], *, header_summed: bool) -> bytes:
    """Return one stream frame; page 14.

    Args:
        packets: Packet ids in the order they were requested.
        values: Readings by packet id.
        header_summed: Whether the checksum covers the header, as on a Create 2; according to the
            Create 1 manual it does not.
    """
    body = b"".join(bytes([packet]) + encode_packets([packet], values) for packet in packets)
    frame = bytes([HEADER, len(body)]) + body
    return frame + bytes([-sum(frame if header_summed else frame[1:]) & 0xFF])


def frame_size(packets: Sequence[int]) -> int:
    """Return the size of a stream frame with ``packets`` [bytes]."""
    return 3 + sum(1 + size_of(packet) for packet in packets)


def fits_frame(packets: Sequence[int]) -> bool:
    """Return whether a frame can hold ``packets``: its length is one byte."""
    return frame_size(packets) - 3 <= 0xFF


def fits_stream(packets: Sequence[int], baud: int) -> bool:
    """Return whether a frame is sent before the next one is due; page 14."""
    return frame_size(packets) <= baud / BITS_PER_BYTE * PERIOD


class StreamParser:
    """The host's side of the line: bytes in, verified frames out.

    A frame must have the header, the length, every id in its place and the right checksum. The
    header byte may also occur in the data, so after a candidate that fails the search resumes one
    byte later. Two checksum conventions are in use; the first ``LOCK`` good frames in a row show
    which of them the base follows, and are themselves not returned.

    Attributes:
        bad: Frames with a wrong checksum.
        skipped: Bytes that belonged to no frame.
        header_summed: Whether the checksum covers the header; None until that is known.
    """

    LOCK = 3

    def __init__(self, packets: Sequence[int]) -> None:
        self.bad = self.skipped = 0
        self.header_summed: bool | None = None
        self._packets = list(packets)
        self._size = frame_size(packets)
        self._marks = _marks(packets)
        self._buffer = bytearray()
        self._runs = {True: 0, False: 0}

    def feed(self, data: bytes) -> list[dict[int, int]]:
        """Take in ``data``; return each frame completed, as values by packet id."""
        self._buffer += data
        frames = []
        while (start := self._candidate()) is not None:
            self._skip(start)
            if len(self._buffer) < self._size:
                break

            # Verify the checksum
            frame = bytes(self._buffer[: self._size])
            summed = self._convention(frame)
            if summed is None:
                self.bad += 1
                self._runs = {True: 0, False: 0}
                self._skip(1)
                continue

            # Decode, or learn the convention
            del self._buffer[: self._size]
            if self.header_summed is not None:
                frames.append(self._values(frame))
            else:
                self._learn(summed)
        return frames

    def _candidate(self) -> int | None:
        """Return where a frame may begin; None, with the buffer emptied, if nowhere."""
        buffer, start = self._buffer, -1
        while (start := buffer.find(HEADER, start + 1)) >= 0:
            known = len(buffer) - start
            if all(buffer[start + at] == mark for at, mark in self._marks if at < known):
                return start
        self._skip(len(buffer))
        return None

    def _skip(self, count: int) -> None:
        self.skipped += count
        del self._buffer[:count]

    def _convention(self, frame: bytes) -> bool | None:
        """Return whether the checksum of ``frame`` covers the header; None if it is wrong."""
        total = sum(frame) & 0xFF
        summed = {0: True, HEADER: False}.get(total)
        return summed if self.header_summed in (None, summed) else None

    def _learn(self, summed: bool) -> None:
        self._runs = {summed: self._runs[summed] + 1, not summed: 0}
        if self._runs[summed] >= self.LOCK:
            self.header_summed = summed

    def _values(self, frame: bytes) -> dict[int, int]:
        ids = [at for at, _ in self._marks[2:]]
        data = b"".join(
            frame[at + 1 : at + 1 + size_of(packet)]
            for at, packet in zip(ids, self._packets, strict=True)
        )
        return decode_packets(self._packets, data)


def _marks(packets: Sequence[int]) -> list[tuple[int, int]]:
    """Return (place, value) of the bytes of a frame that are known: header, length and ids."""
    marks, place = [(0, HEADER), (1, frame_size(packets) - 3)], 2
    for packet in packets:
        if size_of(packet) == 0:
            raise ValueError(f"there is no packet {packet}")
        marks.append((place, packet))
        place += 1 + size_of(packet)
    return marks
