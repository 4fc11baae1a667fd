"""One view as ``views/NNN.npz``: the robot's measurements and the pose of the view."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scan3d_twin.core.session import View
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.recording.image import COMPRESSION_LEVEL, image_arrays, npz_bytes


def view_path(folder: Path, index: int) -> Path:
    """Return the path of view ``index`` of the run in ``folder``."""
    return folder / "views" / f"{index:03d}.npz"


def view_bytes(view: View, level: int = COMPRESSION_LEVEL) -> bytes:
    """Return ``view`` as an .npz compressed at ``level``; equal views give equal bytes.

    Its arrays, by the names and with the units of ``RangeImage``, ``LidarSpec`` and ``View``:
    ``stamps, yaws, ranges, codes, elevations, beam_times, range_limits, T_base_lidar, T_odom_scan,
    T_world_scan`` (poses as x, y, yaw) and ``target_points`` (n, 3) in frame ``scan`` with their
    ``target_lines`` and ``target_beams``; ``line_elevations`` as in ``image_bytes``.
    """
    return npz_bytes(
        level,
        **image_arrays(view.observation.image),
        T_odom_scan=_row(view.observation.T_odom_scan),
        T_world_scan=_row(view.T_world_scan),
        target_points=view.target.points,
        target_lines=view.target.lines.astype(np.int32),
        target_beams=view.target.beams.astype(np.int32),
    )


def _row(pose: Pose2) -> FloatArray:
    return np.array([pose.x, pose.y, pose.yaw])
