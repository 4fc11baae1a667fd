"""Arrays of an .npz file from elsewhere, read within limits."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import FileError
from scan3d_twin.limits import expansion_limit, how_to_raise

MAX_MEMBERS = 1000
"""Most arrays of a file; ours hold a dozen."""
_HEADER_SIZE = 4096
"""Room for the header of an array, which ``np.lib.format`` pads to 64 bytes."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions of arrays: those of NumPy. LZMA takes as much memory as a file asks for."""
_NUMBERS = "biuf"
"""Kinds of arrays that hold numbers: bool, integer and floating point."""
_READ_ERRORS = (
    ValueError,
    SyntaxError,
    tokenize.TokenError,
    KeyError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    OverflowError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors of ``zipfile`` and ``np.lib.format`` on damaged, encrypted and unknown content."""


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, npt.NDArray[Any]]:
    """Return those of the arrays ``names`` that the file at ``path`` holds.

    Raises:
        FileError: It cannot be read, is no .npz file, holds arrays that are no numbers, or expands
            to far more than its size.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(archive, path)
            present = set(archive.namelist())
            return {name: _read(archive, name) for name in names if f"{name}.npy" in present}
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except _READ_ERRORS as error:
        raise FileError(f"{path} is no sweep of twin scan, sim or real: {error}") from None


def _check_sizes(archive: zipfile.ZipFile, path: Path) -> None:
    members = archive.infolist()
    stated = sum(each.file_size for each in members)
    if len(members) > MAX_MEMBERS:
        raise FileError(f"{path} holds {len(members)} files: no sweep of twin scan, sim or real")
    if any(each.compress_type not in _METHODS for each in members):
        raise FileError(f"{path} is packed in a way that NumPy does not write: no sweep of ours")
    if stated > expansion_limit(path.stat().st_size):
        raise FileError(
            f"{path} expands to {stated / 1e6:.0f} MB, far more than its size; {how_to_raise()}"
        )


def _read(archive: zipfile.ZipFile, name: str) -> npt.NDArray[Any]:
    """Return the array ``name``; its header must state what is there before room is made for it."""
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as file:
        # Read the header
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{name}: version {version} of the format")
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, by_columns, dtype = read_header(file, max_header_size=_HEADER_SIZE)

        # Check it against the size
        size = dtype.itemsize * int(np.prod(shape, dtype=object))
        if dtype.kind not in _NUMBERS or size != info.file_size - file.tell():
            raise ValueError(f"{name}: {dtype} {shape} does not fit")
        flat = np.frombuffer(file.read(size), dtype)
    return flat.reshape(shape, order="F" if by_columns else "C")
