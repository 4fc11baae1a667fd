"""Large arrays of values that are kept for long but seldom read: folded, without loss of a bit.

A session keeps all its views, and a robot's computer may be small. What is folded reads as before,
only slower: it is unfolded each time. Ranges and codes are few different numbers, so that each is
kept once; headings run smoothly, so that their second differences are small.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import ConfigError

AnyArray = npt.NDArray[Any]
T = TypeVar("T")
FEW = 2
"""Numbers are kept once each if they occur so often on average."""
FAST = 1
"""Level of compression: higher ones take longer and gain little."""


@dataclass(frozen=True)
class Folded:
    """A folded array of 8-byte numbers.

    Attributes:
        shape: Of the array.
        dtype: Of its numbers.
        numbers: The different ones, as bits; empty if there are too many.
        packed: Places in ``numbers``, or second differences along the rows, compressed.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    numbers: npt.NDArray[np.uint64]
    packed: bytes

    @staticmethod
    def of(array: AnyArray) -> Folded:
        """Fold ``array`` (n_lines, n_beams).

        Raises:
            ConfigError: It has other than 8-byte numbers.
        """
        if array.dtype.itemsize != 8:
            raise ConfigError(f"only numbers of 8 bytes can be folded, not {array.dtype}")
        bits = np.ascontiguousarray(array).view(np.uint64)
        numbers, places = np.unique(bits, return_inverse=True)
        if len(numbers) * FEW > bits.size or len(numbers) > 1 << 16:
            numbers, rest = numbers[:0], _shuffled(_differences(_differences(bits)))
        else:
            numbers, rest = numbers.copy(), _shuffled(places.reshape(-1).astype(np.uint16))
        return Folded(array.shape, array.dtype, numbers, zlib.compress(rest, FAST))

    def unfold(self) -> AnyArray:
        """Return the array, which refuses writes."""
        rest = zlib.decompress(self.packed)
        if len(self.numbers):
            array = self.numbers[_unshuffled(rest, np.dtype(np.uint16))].reshape(self.shape)
        else:
            twice = _unshuffled(rest, np.dtype(np.uint64)).reshape(self.shape)
            once = np.cumsum(twice, axis=-1, dtype=np.uint64)
            array = np.cumsum(once, axis=-1, dtype=np.uint64)
        array = np.asarray(array.view(self.dtype))
        array.flags.writeable = False
        return array


class Unfolds(Protocol):
    """Stands for an array that was put away."""

    def unfold(self) -> AnyArray:
        """Return the array."""
        ...


class Foldable:
    """A field whose array may have been put away; reading it gives the array."""

    def __init__(self, name: str) -> None:
        self._place = f"_{name}"

    def __get__(self, instance: object, owner: type) -> AnyArray:
        held: AnyArray | Unfolds = instance.__dict__[self._place]
        return held if isinstance(held, np.ndarray) else held.unfold()

    def __set__(self, instance: object, value: AnyArray | Unfolds) -> None:
        instance.__dict__[self._place] = value


def foldable(*names: str) -> Callable[[type[T]], type[T]]:
    """Return a decorator for a dataclass whose fields ``names`` are ``Foldable``."""

    def decorate(cls: type[T]) -> type[T]:
        for name in names:
            setattr(cls, name, Foldable(name))
        return cls

    return decorate


def is_folded(instance: object, name: str) -> bool:
    """Tell whether the array in the ``Foldable`` of that ``name`` was put away."""
    return not isinstance(instance.__dict__[f"_{name}"], np.ndarray)


def fold(instance: object, *names: str) -> None:
    """Put the arrays in the ``Foldable`` of those ``names`` away; doing so twice does nothing."""
    for name in names:
        if not is_folded(instance, name):
            object.__setattr__(instance, name, Folded.of(getattr(instance, name)))


def _differences(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return each row's first number and the differences of the others, modulo 2^64."""
    result = bits.copy()
    result[..., 1:] -= bits[..., :-1]
    return result


def _shuffled(numbers: npt.NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then the second ones and so on."""
    return numbers.reshape(-1, 1).view(np.uint8).T.tobytes()


def _unshuffled(data: bytes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    columns = np.frombuffer(data, np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(columns.T).view(dtype).reshape(-1)
