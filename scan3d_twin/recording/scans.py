"""Reads range images from the folders that ``twin scan``, ``twin sim`` and ``twin real`` wrote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import FloatArray, LidarSpec, RangeImage, read_only
from scan3d_twin.devices.registry import DEFAULT_LIDAR, lidar_device
from scan3d_twin.recording.checks import check_image
from scan3d_twin.recording.npz import read_arrays

SCAN_FILE, BACK_SCAN_FILE = "scan.npz", "scan_back.npz"
"""Files of ``twin scan``: a sweep, and with --back the sweep in the other direction."""
_ARRAYS = ("stamps", "yaws", "ranges", "codes", "elevations", "beam_times", "T_base_lidar")
"""Arrays that each file holds."""
_OPTIONAL = ("range_limits", "line_elevations", "T_scan_axis", "noise")
"""Arrays that old files, or those of other lidars, lack."""


def read_image(path: Path) -> RangeImage:
    """Return the range image in ``path``, written by ``image_bytes`` or ``view_bytes``.

    Raises:
        FileError: The file is missing or holds no range image.
    """
    arrays = read_arrays(path, (*_ARRAYS, *_OPTIONAL))
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise FileError(f"{path} is no sweep of twin scan, sim or real: no {missing[0]}")
    try:
        image = _image_of(arrays)
        check_image(image)
    except (FileError, ValueError, TypeError, IndexError) as error:
        raise FileError(f"{path} is no sweep of twin scan, sim or real: {error}") from None
    return image


def _image_of(arrays: Mapping[str, FloatArray]) -> RangeImage:
    low, high = _range_limits(arrays)
    steps = np.abs(np.diff(arrays["stamps"]))
    own, axis, noise = (arrays.get(name) for name in _OPTIONAL[1:])
    if arrays["codes"].dtype.kind not in "iu":
        raise ValueError("codes that are no integers")
    return RangeImage(
        stamps=read_only(arrays["stamps"]),
        yaws=read_only(arrays["yaws"]),
        ranges=read_only(arrays["ranges"]),
        codes=read_only(arrays["codes"], np.int64),
        spec=LidarSpec(
            elevations=read_only(arrays["elevations"]),
            beam_times=read_only(arrays["beam_times"]),
            line_period=float(np.median(steps)) if len(steps) else 0.0,
            min_range=low,
            max_range=high,
        ),
        T_base_lidar=read_only(arrays["T_base_lidar"]),
        elevations=None if own is None else read_only(own),
        T_scan_axis=None if axis is None else read_only(axis),
        noise=None if noise is None else read_only(noise),
    )


def _range_limits(arrays: Mapping[str, FloatArray]) -> tuple[float, float]:
    """Return the lidar's shortest and longest distance [m]; old files do not hold them."""
    if "range_limits" in arrays:
        low, high = arrays["range_limits"].tolist()
        return low, high
    sensor = lidar_device(DEFAULT_LIDAR).sensor
    return sensor.min_range_mm / 1000, sensor.max_range_mm / 1000


def read_places(folder: Path) -> list[list[RangeImage]]:
    """Return all sweeps in ``folder`` and the folders in it, grouped by the place of the robot.

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
