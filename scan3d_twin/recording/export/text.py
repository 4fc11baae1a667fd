"""Clouds as text: XYZ, the folders of scans that 3DTK calls uos, and poses as CSV."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scan3d_twin.core.types import FloatArray
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.run.folder import write_file


def encode_xyz(piece: Piece) -> bytes:
    """Return the points of ``piece`` as lines ``x y z`` [m], to a tenth of a millimetre."""
    return _lines(piece.model.points, "%.4f")


def poses_csv(parts: Sequence[Piece]) -> str:
    """Return the pose of each part's frame in ``world`` [m, rad] as CSV."""
    rows = ["name,x_m,y_m,yaw_rad"]
    for part in parts:
        pose = part.T_world_piece
        rows.append(f"{part.name},{pose.x:.6f},{pose.y:.6f},{pose.yaw:.8f}")
    return "\n".join(rows) + "\n"


def write_uos(parts: Sequence[Piece], path: Path) -> list[Path]:
    """Write ``scanNNN.3d`` and ``scanNNN.pose`` for each part to the folder ``path``.

    3DTK's convention: centimetres in a left-handed frame, x right, y up, z ahead; a pose is the
    place and the angles about x, y and z [deg]; a positive angle about y turns right.
    """
    written = []
    for index, part in enumerate(parts):
        pose = part.T_world_piece
        scan, place = (path / f"scan{index:03d}.{suffix}" for suffix in ("3d", "pose"))
        write_file(scan, _lines(_left_handed(part.model.points), "%.2f"))
        x, y, z = _left_handed(np.array([[pose.x, pose.y, 0.0]]))[0]
        turn = -math.degrees(pose.yaw)
        write_file(place, f"{x:.4f} {y:.4f} {z:.4f}\n0 {turn:.6f} 0\n")
        written += [scan, place]
    return written


def _left_handed(points: FloatArray) -> FloatArray:
    """Return ``points`` (n, 3), x ahead, y left, z up [m], as 3DTK has them [cm]."""
    return 100.0 * np.stack([-points[:, 1], points[:, 2], points[:, 0]], axis=1)


def _lines(points: FloatArray, form: str) -> bytes:
    buffer = io.BytesIO()
    np.savetxt(buffer, points, fmt=form)
    return buffer.getvalue()
