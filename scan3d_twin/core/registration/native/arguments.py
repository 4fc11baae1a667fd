"""What compiled functions take: contiguous arrays, by address, and structures that hold them.

``ctypes`` checks neither type nor layout of an array that is passed by address; these do.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

ARRAY_HEADER = object.__basicsize__
"""Bytes of an array object before its data pointer, the first field of NumPy's ``PyArrayObject``.
``array.ctypes.data`` gives the same address, but takes longer than some of the functions here."""


def address_of(array: npt.NDArray[Any]) -> int:
    """Return the address of the data of ``array``."""
    return ctypes.c_size_t.from_address(id(array) + ARRAY_HEADER).value


class Array(ctypes.c_void_p):
    """Address of a contiguous array of ``dtype``; None is no array."""

    dtype: ClassVar[np.dtype[Any]]

    @classmethod
    def from_param(cls, array: npt.NDArray[Any] | None) -> Array:
        """Return ``array`` as an argument of a function; raise as ``locate`` does."""
        return cls(cls.locate(array))

    @classmethod
    def locate(cls, array: npt.NDArray[Any] | None) -> int | None:
        """Return the address of ``array``.

        Raises:
            TypeError: The array is of another type or not contiguous.
        """
        if array is None:
            return None
        if array.dtype != cls.dtype or not array.flags.c_contiguous:
            raise TypeError(f"{cls.__name__} takes contiguous arrays of {cls.dtype}")
        return address_of(array)


class Doubles(Array):
    """Array of float64."""

    dtype = np.dtype(np.float64)


class Ints(Array):
    """Array of int32."""

    dtype = np.dtype(np.int32)


class Longs(Array):
    """Array of int64."""

    dtype = np.dtype(np.int64)


class Flags(Array):
    """Array of bool."""

    dtype = np.dtype(np.bool_)


class Bytes(Array):
    """Array of uint8."""

    dtype = np.dtype(np.uint8)


class Value(ctypes.Structure):
    """A structure of ``engine.h``; it keeps alive the arrays that it points to."""

    converters: ClassVar[dict[str, Callable[[Any], Any]]]

    def __init_subclass__(cls) -> None:
        cls.converters = {
            name: kind.locate if issubclass(kind, Array) else _filler_of(kind)
            for name, kind, *_ in cls._fields_
            if issubclass(kind, (Array, ctypes.Array))
        }

    def __init__(self, **fields: Any) -> None:
        """Set ``fields``: array arguments by address, fixed-size arrays by value."""
        converters = self.converters
        super().__init__(
            **{
                name: converters[name](value) if name in converters else value
                for name, value in fields.items()
            }
        )
        self.alive = fields

    def numbers(self, name: str, *shape: int) -> npt.NDArray[np.float64]:
        """Return a read-only copy of the first numbers of an array field, in ``shape``."""
        field = bytes(getattr(self, name))
        return np.frombuffer(field, np.float64, math.prod(shape)).reshape(shape)


def _filler_of(kind: Any) -> Callable[[Any], Any]:
    """Return the function that makes a fixed-size array field; numbers not given are 0."""
    dtype = np.dtype(kind._type_)

    def fill(numbers: Any) -> Any:
        if isinstance(numbers, np.ndarray):
            return kind.from_buffer_copy(np.ascontiguousarray(numbers, dtype))
        return kind(*numbers)

    return fill
