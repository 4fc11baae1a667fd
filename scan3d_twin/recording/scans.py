"""Reads range images from the folders that ``twin scan``, ``twin sim`` and ``twin real`` wrote."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import LidarSpec, RangeImage, read_only
from scan3d_twin.devices.urg import model as urg04lx

SCAN_FILE, BACK_SCAN_FILE = "scan.npz", "scan_back.npz"
"""Files of ``twin scan``: a sweep, and with --back the sweep in the other direction."""


def read_image(path: Path) -> RangeImage:
    """Return the range image in ``path``, written by ``image_bytes`` or ``view_bytes``.

    Raises:
        FileError: The file is missing or holds no range image.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return RangeImage(
                stamps=read_only(arrays["stamps"]),
                yaws=read_only(arrays["yaws"]),
                ranges=read_only(arrays["ranges"]),
                codes=read_only(arrays["codes"], np.int64),
                spec=LidarSpec(
                    elevations=read_only(arrays["elevations"]),
                    beam_times=read_only(arrays["beam_times"]),
                    line_period=float(np.median(np.abs(np.diff(arrays["stamps"])))),
                    min_range=urg04lx.MIN_RANGE_MM / 1000,
                    max_range=urg04lx.MAX_RANGE_MM / 1000,
                ),
                T_base_lidar=read_only(arrays["T_base_lidar"]),
            )
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except (KeyError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(f"{path} is no sweep of twin scan, sim or real: {error}") from error


def read_places(folder: Path) -> list[list[RangeImage]]:
    """Return all sweeps in ``folder`` and its subfolders, grouped by the place of the robot.

    A sweep and the one back come from one place; all others count as different places.

    Raises:
        FileError: There is no sweep, or one cannot be read.
    """
    paths = (
        sorted(p for p in folder.glob("**/*.npz") if p.name != BACK_SCAN_FILE)
        if folder.is_dir()
        else []
    )
    if not paths:
        raise FileError(
            f"no sweeps in {folder}: give the folder of `twin scan --width 360` or of a run"
        )
    return [[read_image(path) for path in _one_place(path)] for path in paths]


def _one_place(path: Path) -> list[Path]:
    back = path.with_name(BACK_SCAN_FILE)
    return [path, back] if path.name == SCAN_FILE and back.exists() else [path]
