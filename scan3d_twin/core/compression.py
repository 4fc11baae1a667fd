"""Lossless compression of large arrays that a session keeps but seldom reads.

A compressed array reads as before, only slower: it is decompressed on access, and the arrays read
last are cached. Ranges are whole millimetres and codes small numbers, so that most of them fit into
two bytes; headings change smoothly, so that their second differences are small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import zstandard

from scan3d_twin.core.errors import ConfigError

AnyArray = npt.NDArray[Any]
T = TypeVar("T")
CACHED_ARRAYS = 4
"""Arrays read last that are cached decompressed: most of those of one view."""
MAX_SHORT = 32_000
"""Largest whole number, or number of thousandths, that is stored in two bytes."""
ESCAPE = -32_768
"""Two-byte code of all other numbers; as a floating-point number it reads as NaN."""
MIN_SHORTS_PER_ESCAPE = 8
"""Ratio of all numbers to those that need ``ESCAPE`` from which on two bytes each are smaller."""
ZSTD_LEVEL = 1
"""Compression level: higher ones take longer and gain little."""


@dataclass(frozen=True, eq=False)
class CompressedArray:
    """A compressed array of 8-byte numbers.

    Attributes:
        shape: Shape of the array.
        dtype: Type of its numbers.
        packed: The numbers in two bytes, or their second differences along the rows, compressed.
        others: Flat indices (n,) of the numbers coded by ``ESCAPE``; None for differences.
        values: These numbers (n,), as bits.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    packed: bytes
    others: npt.NDArray[np.int32] | None
    values: npt.NDArray[np.uint64]

    @staticmethod
    def of(array: AnyArray) -> CompressedArray:
        """Return ``array`` (n_lines, n_beams), compressed.

        Raises:
            ConfigError: The numbers are not of 8 bytes.
        """
        if array.dtype.itemsize != 8:
            raise ConfigError(f"only numbers of 8 bytes can be compressed, not {array.dtype}")
        bits = np.ascontiguousarray(array).view(np.uint64)
        short = _to_shorts(array)
        others = np.flatnonzero(_from_shorts(short, array.dtype).view(np.uint64) != bits)
        if len(others) * MIN_SHORTS_PER_ESCAPE > bits.size:
            packed = _pack(_difference(_difference(bits)))
            return CompressedArray(array.shape, array.dtype, packed, None, bits[:0].ravel())
        values = bits.reshape(-1)[others]
        return CompressedArray(
            array.shape, array.dtype, _pack(short), others.astype(np.int32), values
        )

    def decompress(self) -> AnyArray:
        """Return the array, read-only."""
        return _decompress(self)


@lru_cache(maxsize=CACHED_ARRAYS)
def _decompress(compressed: CompressedArray) -> AnyArray:
    """Return the array behind ``compressed``, read-only."""
    if compressed.others is None:
        twice = _unpack(compressed.packed, np.dtype(np.uint64)).reshape(compressed.shape)
        once = np.cumsum(twice, axis=-1, dtype=np.uint64)
        bits = np.cumsum(once, axis=-1, dtype=np.uint64, out=once)
    else:
        short = _unpack(compressed.packed, np.dtype(np.int16)).reshape(compressed.shape)
        bits = _from_shorts(short, compressed.dtype).view(np.uint64)
        bits.reshape(-1)[compressed.others] = compressed.values
    array = np.asarray(bits.view(compressed.dtype))
    array.flags.writeable = False
    return array


def _to_shorts(array: AnyArray) -> npt.NDArray[np.int16]:
    """Return integers as they are and floats in thousandths; ``ESCAPE`` where too large."""
    whole = np.rint(1e3 * array) if array.dtype.kind == "f" else array
    near = (whole >= -MAX_SHORT) & (whole <= MAX_SHORT)
    return np.where(near, whole, ESCAPE).astype(np.int16)


def _from_shorts(short: npt.NDArray[np.int16], dtype: np.dtype[Any]) -> AnyArray:
    """Return ``short`` as numbers of type ``dtype``: the inverse of ``_to_shorts``."""
    if dtype.kind != "f":
        return short.astype(dtype)
    numbers = short / 1e3
    numbers[short == ESCAPE] = np.nan
    return numbers


class Compressed(Protocol):
    """An array in compressed form."""

    def decompress(self) -> AnyArray:
        """Return the array."""
        ...


class CompressibleField:
    """Descriptor of a field whose array may be compressed; reading it returns the array.

    A field that is optional may hold None, which stays as it is.
    """

    def __init__(self, name: str) -> None:
        self._place = f"_{name}"

    def __get__(self, instance: object, owner: type) -> AnyArray | None:
        held: AnyArray | Compressed | None = instance.__dict__[self._place]
        return held if held is None or isinstance(held, np.ndarray) else held.decompress()

    def __set__(self, instance: object, value: AnyArray | Compressed | None) -> None:
        instance.__dict__[self._place] = value


def compressible(*names: str) -> Callable[[type[T]], type[T]]:
    """Return a decorator that makes the fields ``names`` of a dataclass compressible."""

    def decorate(cls: type[T]) -> type[T]:
        for name in names:
            setattr(cls, name, CompressibleField(name))
        return cls

    return decorate


def is_compressed(instance: object, name: str) -> bool:
    """Return whether the ``CompressibleField`` ``name`` of ``instance`` is compressed, or None."""
    return not isinstance(instance.__dict__[f"_{name}"], np.ndarray)


def compress_fields(names: Sequence[str], *instances: object) -> None:
    """Compress the fields ``names`` of all ``instances`` that are not compressed yet.

    An array that several of the ``instances`` share is compressed once.
    """
    compressed: dict[int, tuple[AnyArray, CompressedArray]] = {}
    for instance, name in product(instances, names):
        if not is_compressed(instance, name):
            array = getattr(instance, name)
            if id(array) not in compressed:
                compressed[id(array)] = array, CompressedArray.of(array)
            object.__setattr__(instance, name, compressed[id(array)][1])


def _difference(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return each row's first number and the differences of the others, modulo 2^64."""
    result = bits.copy()
    result[..., 1:] -= bits[..., :-1]
    return result


def _pack(numbers: npt.NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then the second bytes and so on, compressed."""
    columns = numbers.reshape(-1, 1).view(np.uint8).T
    return zstandard.compress(columns.tobytes(), ZSTD_LEVEL)


def _unpack(packed: bytes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return the numbers of type ``dtype`` in ``packed``: the inverse of ``_pack``."""
    columns = np.frombuffer(zstandard.decompress(packed), np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(columns.T).view(dtype).reshape(-1)
