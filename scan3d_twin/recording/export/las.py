"""LAS 1.2 and its compressed form LAZ, through laspy."""

from __future__ import annotations

import io

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.recording.export.unit import PER_METRE

COORDINATE_STEP = 1e-4
"""Resolution of the coordinates [m]: a fiftieth of the lidar's noise."""
CREATION_DATE = slice(90, 94)
"""Place of day and year of the file's creation in the header (LAS 1.2, table 2); 0 is unknown."""


def encode_las(piece: Piece) -> bytes:
    """Return ``piece`` as a LAS file; the index of the view is the point source id."""
    return _encode(piece, compressed=False)


def encode_laz(piece: Piece) -> bytes:
    """Return ``piece`` as a LAZ file; the index of the view is the point source id."""
    return _encode(piece, compressed=True)


def _encode(piece: Piece, *, compressed: bool) -> bytes:
    try:
        import laspy
    except ImportError as error:
        raise ConfigError("LAS and LAZ files need laspy: pip install 'laspy[lazrs]'") from error

    # Write a reproducible header
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, COORDINATE_STEP * PER_METRE[piece.unit])
    header.generating_software = "scan3d_twin"

    # Fill points, views and colours; LAS counts the returns of a pulse from 1
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = piece.model.points.T
    cloud.return_number[:] = cloud.number_of_returns[:] = 1
    cloud.point_source_id = piece.model.view.astype(np.uint16)
    # LAS colours have 16 bits; 257 maps 255 to 65535.
    cloud.red, cloud.green, cloud.blue = (
        257 * view_colours_rgb(piece.model.view).astype(np.uint16)
    ).T

    # Encode as LAS or LAZ
    buffer = io.BytesIO()
    cloud.write(buffer, do_compress=compressed)
    content = bytearray(buffer.getvalue())
    # laspy writes today's date; without one, the same run gives the same bytes on any day
    content[CREATION_DATE] = bytes(CREATION_DATE.stop - CREATION_DATE.start)
    return bytes(content)


LAS = CloudFormat(suffix=".las", encode=encode_las)
LAZ = CloudFormat(suffix=".laz", encode=encode_laz)
