"""Reads the raw scans of PiLiDAR, ``ID_lidar.pkl``: a scanner of a Raspberry Pi and an LD06.

By its source (github.com/PiLiDAR/PiLiDAR: ``get_scan_dict`` and ``merge_2D_points`` of
``lib/pointcloud.py``, ``polar2cartesian`` of ``lib/lidar_driver.py``, ``config.json``), the file is
a pickled dictionary. ``z_angles`` has the angle of the stepper motor for each plane [deg], and
``cartesian`` for each plane an array of x, y [mm] and intensity in it, all 0 where there was no
return, in which direction is then unknown. A plane is rotated by ``LIDAR_OFFSET_ANGLE`` about y,
shifted by ``Y_OFFSET`` and rotated by minus its angle about z.

A pickle may call any function of Python. This reader knows lists, dictionaries and numbers, and
makes arrays itself; at any other name it stops.
"""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.scanning.calibration.extrinsics import tilt_matrix
from scan3d_twin.limits import how_to_raise, scaled
from scan3d_twin.recording.importing.readings import MAX_READINGS, Readings, clean_ranges

SUFFIX = ".pkl"
MAX_SIZE = 300_000_000
"""Largest file [bytes]; a scan of 990 planes takes 26 MB."""
LIDAR_OFFSET_ANGLE = math.radians(-1.05)
"""Rotation of the plane about the axis to the left [rad], by PiLiDAR's ``config.json``."""
Y_OFFSET = -0.0375
"""Distance of the plane from the axis, to the left [m], by PiLiDAR's ``config.json``."""
_NUMBERS = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
"""Types of arrays that hold numbers."""


class _Dtype:
    """The type of an array, by its code."""

    def __init__(self, code: Any = "", *_: Any) -> None:
        self.code = code

    def __setstate__(self, _: Any) -> None:
        """Take no notice of the byte order: all computers of these scanners are little-endian."""


class _Array:
    """An array that was pickled."""

    def __init__(self) -> None:
        self._state: Any = None

    def __setstate__(self, state: Any) -> None:
        self._state = state

    def to_numpy(self) -> npt.NDArray[Any]:
        """Return the array.

        Raises:
            ValueError: It holds no numbers, or not as many as it states.
        """
        _, shape, dtype, by_columns, data = self._state
        if not isinstance(dtype, _Dtype) or str(dtype.code) not in _NUMBERS:
            raise ValueError("an array without numbers")
        flat = np.frombuffer(data, np.dtype(f"<{dtype.code}"))
        return flat.reshape(shape, order="F" if by_columns else "C")


def _make_array(*_: Any) -> _Array:
    return _Array()


def _make_scalar(dtype: Any, data: Any) -> float:
    if not isinstance(dtype, _Dtype) or str(dtype.code) not in _NUMBERS:
        raise ValueError("a value that is no number")
    return float(np.frombuffer(data, np.dtype(f"<{dtype.code}"))[0])


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any, *_: Any) -> _Array:
    array = _Array()
    array.__setstate__((1, shape, dtype, order == "F", data))
    return array


class _Marker:
    """The type of arrays, which is named and not used."""


_NAMES = {
    ("numpy", "ndarray"): _Marker,
    ("numpy", "dtype"): _Dtype,
    **{
        (f"numpy.{core}.{module}", name): made
        for core in ("core", "_core")
        for module, name, made in (
            ("multiarray", "_reconstruct", _make_array),
            ("multiarray", "scalar", _make_scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}
"""All that a file may name, and what is made of it."""


class _Unpickler(pickle.Unpickler):
    """Reads a pickle that holds arrays and plain values only."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what stands for a name in the file; refuse all but arrays."""
        try:
            return _NAMES[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"it holds a {module}.{name}") from None


_ERRORS = (
    pickle.UnpicklingError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError,
    OverflowError, RecursionError, ImportError, MemoryError,
)  # fmt: skip
"""Errors of a pickle that is damaged, or of another kind."""


def read_pilidar(path: Path) -> list[Readings]:
    """Return the readings in a raw scan of PiLiDAR.

    Raises:
        FileError: It cannot be read, is too large, or is no such file.
    """
    # Read the planes
    try:
        if path.stat().st_size > scaled(MAX_SIZE):
            raise FileError(f"{path} is larger than {MAX_SIZE / 1e6:g} MB; {how_to_raise()}")
        with path.open("rb") as file:
            content = _Unpickler(file).load()
        degrees = np.array([float(each) for each in content["z_angles"]])
        planes = [_read_plane(each) for each in content["cartesian"]]
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from None
    except _ERRORS as error:
        raise FileError(f"{path} is no raw scan of PiLiDAR: {error}") from None

    # Check them
    counts = [len(plane) for plane in planes]
    if len(planes) != len(degrees) or sum(counts) == 0 or not np.all(np.isfinite(degrees)):
        raise FileError(f"{path}: {len(planes)} planes with {len(degrees)} angles")
    if sum(counts) > scaled(MAX_READINGS):
        raise FileError(f"{path} holds {sum(counts)} readings; {how_to_raise()}")

    # Convert them to angles and ranges
    x, y = np.concatenate(planes).T / 1000.0
    T_axis_lidar = np.eye(4)
    T_axis_lidar[:3, :3] = tilt_matrix(0.0, LIDAR_OFFSET_ANGLE)
    T_axis_lidar[1, 3] = Y_OFFSET
    return [
        Readings(
            str(path),
            np.repeat(np.arange(len(planes)), counts),
            None,
            -np.radians(np.repeat(degrees, counts)),
            np.arctan2(y, x),
            clean_ranges(np.hypot(x, y), str(path)),
            T_axis_lidar=T_axis_lidar,
        )
    ]


def _read_plane(plane: Any) -> npt.NDArray[np.float64]:
    """Return x and y (n, 2) [mm] of the returns of one plane."""
    points = np.asarray(plane.to_numpy(), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] < 2:
        raise ValueError(f"a plane of shape {points.shape}")
    with np.errstate(invalid="ignore"):
        returned = np.isfinite(points[:, :2]).all(axis=1) & (points[:, :2] != 0.0).any(axis=1)
    return points[returned, :2]
