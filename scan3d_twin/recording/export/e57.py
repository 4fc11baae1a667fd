"""ASTM E57 through pye57: one file with a scan and a pose per view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.run.folder import fresh_part


def write(parts: Sequence[Piece], path: Path) -> list[Path]:
    """Write ``parts`` as the scans of the E57 file ``path``.

    Raises:
        ConfigError: pye57 is missing.
        FileError: The file cannot be written.
    """
    try:
        import pye57
    except ImportError as error:
        raise ConfigError("E57 files need pye57 (on x86-64): pip install pye57") from error

    # Write a part file, then rename
    try:
        with fresh_part(path) as part_file:
            file = pye57.E57(str(part_file), mode="w")
            try:
                for part in parts:
                    _write_scan(file, part)
            finally:
                file.close()
    except (OSError, pye57.libe57.E57Exception) as error:
        raise FileError(f"cannot write {path}: {error}") from error
    return [path]


def _write_scan(file: Any, part: Piece) -> None:
    pose, model = part.T_world_piece, part.model
    data = {f"cartesian{name}": model.points[:, axis] for axis, name in enumerate("XYZ")}
    colours = view_colours_rgb(model.view)
    for channel, name in enumerate(("Red", "Green", "Blue")):
        data[f"color{name}"] = np.ascontiguousarray(colours[:, channel])
    file.write_scan_raw(
        {name: np.ascontiguousarray(values) for name, values in data.items()},
        name=part.name,
        rotation=np.array([math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2)]),
        translation=np.array([pose.x, pose.y, 0.0]),
    )


E57 = CloudFormat(suffix=".e57", write=write)
