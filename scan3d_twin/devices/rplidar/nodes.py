"""Standard nodes (0x81), the unchecked frames of the standard scan: 5 bytes a sample.

A node has three bits that are always the same or opposite, and no checksum: of flipped bits 37 in
40 go unnoticed. Sources as in ``codec``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from scan3d_twin.core.errors import ProtocolError

NODE_LENGTH = 5
ANGLE_UNITS = 64
"""Units of an angle per degree."""
TURN_UNITS = 360 * ANGLE_UNITS
DISTANCE_UNITS = 4
"""Units of a distance per millimetre."""
MAX_DISTANCE = (1 << 16) - 1
"""Longest distance [1/4 mm]."""
MAX_QUALITY = 63


@dataclass(frozen=True, slots=True)
class Node:
    """One sample.

    Attributes:
        angle: Clockwise, from 0 to below a turn [1/64 deg].
        distance: Distance [1/4 mm]; 0 where there is none.
        quality: Strength of the return, 0 to 63.
        is_first: Whether a new turn begins here (S).
    """

    angle: int
    distance: int
    quality: int
    is_first: bool = False

    def encode(self) -> bytes:
        """Return the bytes of the node."""
        flags = 1 if self.is_first else 2
        return struct.pack("<BHH", self.quality << 2 | flags, self.angle << 1 | 1, self.distance)


def is_node(data: bytes | bytearray, at: int) -> bool:
    """Return whether the fixed bits of a node stand in ``data`` at ``at``, and a valid angle."""
    if data[at] & 3 not in (1, 2) or not data[at + 1] & 1:
        return False
    return angle_at(data, at) < TURN_UNITS


def angle_at(data: bytes | bytearray, at: int) -> int:
    """Return the angle of the node at ``at`` [1/64 deg]."""
    return (data[at + 1] | data[at + 2] << 8) >> 1


def decode_node(frame: bytes) -> Node:
    """Return the sample in 5 bytes.

    Raises:
        ProtocolError: Its fixed bits are wrong, or its angle is beyond a turn.
    """
    if len(frame) != NODE_LENGTH or not is_node(frame, 0):
        raise ProtocolError(f"not a node: {frame.hex(' ')}")
    first, angle, distance = struct.unpack("<BHH", frame)
    return Node(angle >> 1, distance, first >> 2, bool(first & 1))
