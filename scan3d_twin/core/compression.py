"""Lossless compression of large arrays that are kept for long but seldom read.

A session keeps all its views, and a robot's computer may be small. A compressed
array reads as before, only slower: it is decompressed when it is read, and the last ones read are
cached. Ranges are
whole millimetres and codes small numbers, so that two bytes do for each; headings run smoothly, so
that their second differences are small.
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
AT_HAND = 4
"""Arrays that were read last and are kept decompressed: most of those of one view."""
LIMIT = 32_000
"""Whole numbers, or thousandths, up to this are kept in two bytes."""
OTHER = -32_768
"""Stands for all others; of floating-point numbers it reads as NaN."""
SOME = 8
"""So many times more numbers than there are others make two bytes each worth while."""
FAST = 1
"""Level of compression: higher ones take longer and gain little."""


@dataclass(frozen=True, eq=False)
class CompressedArray:
    """A compressed array of 8-byte numbers.

    Attributes:
        shape: Of the array.
        dtype: Of its numbers.
        packed: The numbers in two bytes, or second differences along the rows, compressed.
        others: Places (n,) of numbers that two bytes do not hold; None for differences.
        values: These numbers (n,), as bits.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    packed: bytes
    others: npt.NDArray[np.int32] | None
    values: npt.NDArray[np.uint64]

    @staticmethod
    def of(array: AnyArray) -> CompressedArray:
        """Fold ``array`` (n_lines, n_beams).

        Raises:
            ConfigError: It has other than 8-byte numbers.
        """
        if array.dtype.itemsize != 8:
            raise ConfigError(f"only numbers of 8 bytes can be compressed, not {array.dtype}")
        bits = np.ascontiguousarray(array).view(np.uint64)
        short = _shortened(array)
        others = np.flatnonzero(_lengthened(short, array.dtype).view(np.uint64) != bits)
        if len(others) * SOME > bits.size:
            packed = _packed(_differences(_differences(bits)))
            return CompressedArray(array.shape, array.dtype, packed, None, bits[:0].ravel())
        values = bits.reshape(-1)[others]
        return CompressedArray(
            array.shape, array.dtype, _packed(short), others.astype(np.int32), values
        )

    def decompress(self) -> AnyArray:
        """Return the array, which refuses writes."""
        return _decompressed(self)


@lru_cache(maxsize=AT_HAND)
def _decompressed(compressed: CompressedArray) -> AnyArray:
    if compressed.others is None:
        twice = _unpacked(compressed.packed, np.dtype(np.uint64)).reshape(compressed.shape)
        once = np.cumsum(twice, axis=-1, dtype=np.uint64)
        bits = np.cumsum(once, axis=-1, dtype=np.uint64, out=once)
    else:
        short = _unpacked(compressed.packed, np.dtype(np.int16)).reshape(compressed.shape)
        bits = _lengthened(short, compressed.dtype).view(np.uint64)
        bits.reshape(-1)[compressed.others] = compressed.values
    array = np.asarray(bits.view(compressed.dtype))
    array.flags.writeable = False
    return array


def _shortened(array: AnyArray) -> npt.NDArray[np.int16]:
    """Return whole numbers, and floating-point ones in thousandths; ``OTHER`` if too large."""
    whole = np.rint(1e3 * array) if array.dtype.kind == "f" else array
    near = (whole >= -LIMIT) & (whole <= LIMIT)
    return np.where(near, whole, OTHER).astype(np.int16)


def _lengthened(short: npt.NDArray[np.int16], dtype: np.dtype[Any]) -> AnyArray:
    """Return the numbers of type ``dtype`` that were shortened."""
    if dtype.kind != "f":
        return short.astype(dtype)
    numbers = short / 1e3
    numbers[short == OTHER] = np.nan
    return numbers


class Compressed(Protocol):
    """Stands for an array that was put away."""

    def decompress(self) -> AnyArray:
        """Return the array."""
        ...


class CompressibleField:
    """A field whose array may have been put away; reading it gives the array."""

    def __init__(self, name: str) -> None:
        self._place = f"_{name}"

    def __get__(self, instance: object, owner: type) -> AnyArray:
        held: AnyArray | Compressed = instance.__dict__[self._place]
        return held if isinstance(held, np.ndarray) else held.decompress()

    def __set__(self, instance: object, value: AnyArray | Compressed) -> None:
        instance.__dict__[self._place] = value


def compressible(*names: str) -> Callable[[type[T]], type[T]]:
    """Return a decorator for a dataclass whose fields ``names`` are ``CompressibleField``."""

    def decorate(cls: type[T]) -> type[T]:
        for name in names:
            setattr(cls, name, CompressibleField(name))
        return cls

    return decorate


def is_compressed(instance: object, name: str) -> bool:
    """Tell whether the array in the ``CompressibleField`` of that ``name`` was put away."""
    return not isinstance(instance.__dict__[f"_{name}"], np.ndarray)


def compress_fields(names: Sequence[str], *instances: object) -> None:
    """Compress the ``CompressibleField`` of those ``names``; doing so twice does nothing.

    An array that several of the ``instances`` share is compressed once.
    """
    compressed: dict[int, tuple[AnyArray, CompressedArray]] = {}
    for instance, name in product(instances, names):
        if not is_compressed(instance, name):
            array = getattr(instance, name)
            if id(array) not in compressed:
                compressed[id(array)] = array, CompressedArray.of(array)
            object.__setattr__(instance, name, compressed[id(array)][1])


def _differences(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return each row's first number and the differences of the others, modulo 2^64."""
    result = bits.copy()
    result[..., 1:] -= bits[..., :-1]
    return result


def _packed(numbers: npt.NDArray[Any]) -> bytes:
    """Return all numbers' first bytes, then the second ones and so on, compressed."""
    columns = numbers.reshape(-1, 1).view(np.uint8).T
    return zstandard.compress(columns.tobytes(), FAST)


def _unpacked(packed: bytes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    columns = np.frombuffer(zstandard.decompress(packed), np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(columns.T).view(dtype).reshape(-1)
