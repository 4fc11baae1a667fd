"""The folders of scans that 3DTK calls uos."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scan3d_twin.core.types import FloatArray
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece, point_lines
from scan3d_twin.run.folder import write_file


def write(parts: Sequence[Piece], path: Path) -> list[Path]:
    """Write ``scanNNN.3d`` and ``scanNNN.pose`` for each part to the folder ``path``.

    3DTK's convention: centimetres in a left-handed frame, x right, y up, z ahead; a pose is the
    place and the angles about x, y and z [deg]; a positive angle about y turns right.
    """
    written = []
    for index, part in enumerate(parts):
        pose = part.T_world_piece
        scan, place = (path / f"scan{index:03d}.{suffix}" for suffix in ("3d", "pose"))
        write_file(scan, point_lines(_left_handed(part.model.points), "%.2f"))
        x, y, z = _left_handed(np.array([[pose.x, pose.y, 0.0]]))[0]
        turn = -math.degrees(pose.yaw)
        write_file(place, f"{x:.4f} {y:.4f} {z:.4f}\n0 {turn:.6f} 0\n")
        written += [scan, place]
    return written


def _left_handed(points: FloatArray) -> FloatArray:
    """Return ``points`` (n, 3), x ahead, y left, z up [m], as 3DTK has them [cm]."""
    return 100.0 * np.stack([-points[:, 1], points[:, 2], points[:, 0]], axis=1)


UOS = CloudFormat(write=write, folder=True, fixed_unit="centimetres")
