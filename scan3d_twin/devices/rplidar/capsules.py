"""Capsules, the checked frames of the express scan (0x82) and the dense scan (0x85).

Both are 84 bytes: sync nibbles 0xA and 0x5, a checksum of 8 bits (exclusive or) cut into two
nibbles, the encoder's angle at the first sample, and the samples. The next capsule's angle is
needed to spread the samples between the two. Sources as in ``codec``; the 6 bits of an express
sample's angle correction are unsigned, as the SDK reads them, although the protocol calls the first
a sign (Roboticia/RPLidar#4).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.rplidar.codec import xor

CAPSULE_LENGTH = 84
EXPRESS_SAMPLES, DENSE_SAMPLES = 32, 40
SYNC_1, SYNC_2 = 0xA, 0x5
ANGLE_UNITS = 64
"""Units of a start angle per degree."""
TURN_UNITS = 360 * ANGLE_UNITS
CORRECTION_STEP = ANGLE_UNITS // 8
"""Unit of an express sample's angle correction, 1/8 deg [1/64 deg]."""
MAX_CORRECTION = 63
MAX_EXPRESS_MM, MAX_DENSE_MM = (1 << 14) - 1, (1 << 16) - 1
_RESTART = 1 << 15
_CABIN = struct.Struct("<HHB")


@dataclass(frozen=True, slots=True)
class Capsule:
    """The samples of one capsule.

    Attributes:
        start: Angle of the encoder at the first sample, clockwise [1/64 deg].
        distances_mm: Distances [mm]; 0 where there is none.
        corrections: To be subtracted from the encoder's angle at each sample [1/8 deg]; empty for
            a dense capsule.
        is_first: Whether the series of capsules begins here: after the scan was started, or after
            the encoder was reset.
    """

    start: int
    distances_mm: tuple[int, ...]
    corrections: tuple[int, ...] = ()
    is_first: bool = False


def encode_express(capsule: Capsule) -> bytes:
    """Return the bytes of an express capsule of 32 samples."""
    samples = list(zip(capsule.distances_mm, capsule.corrections, strict=True))
    cabins = bytearray()
    for (mm_1, turn_1), (mm_2, turn_2) in zip(samples[::2], samples[1::2], strict=True):
        words = mm_1 << 2 | turn_1 >> 4, mm_2 << 2 | turn_2 >> 4
        cabins += _CABIN.pack(*words, turn_1 & 15 | (turn_2 & 15) << 4)
    return _frame(capsule, bytes(cabins))


def encode_dense(capsule: Capsule) -> bytes:
    """Return the bytes of a dense capsule of 40 samples."""
    return _frame(capsule, struct.pack(f"<{DENSE_SAMPLES}H", *capsule.distances_mm))


def decode_express(frame: bytes) -> Capsule:
    """Return the samples of an express capsule.

    Raises:
        ProtocolError: Its sync nibbles or its checksum are wrong.
    """
    start, is_first = _check(frame)
    distances: list[int] = []
    corrections: list[int] = []
    for word_1, word_2, low in _CABIN.iter_unpack(frame[4:]):
        distances += (word_1 >> 2, word_2 >> 2)
        corrections += ((word_1 & 3) << 4 | low & 15, (word_2 & 3) << 4 | low >> 4)
    return Capsule(start, tuple(distances), tuple(corrections), is_first)


def decode_dense(frame: bytes) -> Capsule:
    """Return the samples of a dense capsule.

    Raises:
        ProtocolError: Its sync nibbles or its checksum are wrong.
    """
    start, is_first = _check(frame)
    distances = struct.unpack(f"<{DENSE_SAMPLES}H", frame[4:])
    return Capsule(start, distances, (), is_first)


def is_synced(data: bytes | bytearray, at: int) -> bool:
    """Return whether the two sync nibbles of a capsule stand in ``data`` from ``at`` on."""
    return data[at] >> 4 == SYNC_1 and data[at + 1] >> 4 == SYNC_2


def is_intact(data: bytes | bytearray, at: int) -> bool:
    """Return whether a capsule begins in ``data`` at ``at``, by sync nibbles and checksum."""
    if not is_synced(data, at):
        return False
    stated = data[at] & 15 | (data[at + 1] & 15) << 4
    return xor(data[at + 2 : at + CAPSULE_LENGTH]) == stated


def sample_angles(capsule: Capsule, step: float) -> list[float]:
    """Return the angle of each sample, clockwise, from 0 to below 360 [deg].

    Args:
        capsule: The samples.
        step: Turn of the encoder over this capsule [1/64 deg].
    """
    n = len(capsule.distances_mm)
    corrections = capsule.corrections or (0,) * n
    return [
        (capsule.start + step * k / n - turn * CORRECTION_STEP) % TURN_UNITS / ANGLE_UNITS
        for k, turn in enumerate(corrections)
    ]


def _frame(capsule: Capsule, samples: bytes) -> bytes:
    body = struct.pack("<H", capsule.start | _RESTART * capsule.is_first) + samples
    check = xor(body)
    return bytes([SYNC_1 << 4 | check & 15, SYNC_2 << 4 | check >> 4]) + body


def _check(frame: bytes) -> tuple[int, bool]:
    """Return the start angle [1/64 deg] and whether the series begins here."""
    if len(frame) != CAPSULE_LENGTH or not is_intact(frame, 0):
        raise ProtocolError(f"not a capsule, or damaged: {frame[:8].hex(' ')} ...")
    (word,) = struct.unpack_from("<H", frame, 2)
    start = word & ~_RESTART
    if start >= TURN_UNITS:
        raise ProtocolError(f"a capsule that begins at {start / ANGLE_UNITS:.2f} deg")
    return start, bool(word & _RESTART)
