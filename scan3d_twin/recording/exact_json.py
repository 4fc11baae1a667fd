"""Frozen dataclasses as JSON and bytes, restored bit by bit.

Fields and their type hints define the format, so that a new field needs no code here: a field that
an older file lacks gets its default, one that no longer exists is ignored.
"""

from __future__ import annotations

import json
import math
import types
from dataclasses import Field, fields, is_dataclass
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from scan3d_twin.core.errors import FileError, TwinError
from scan3d_twin.core.options import former_names
from scan3d_twin.run.strict_json import parse_json

Packed = tuple[str, bytes]
"""A JSON text, and the bytes of the arrays it refers to."""
Array = np.ndarray[Any, Any]


class _Packer:
    """Collects the arrays of one value; one that occurs twice is stored once if it ``shares``."""

    def __init__(self, *, shares: bool = True) -> None:
        self._shares = shares
        self._places: dict[int, list[Any]] = {}
        self._alive: list[Array] = []
        self._parts: list[memoryview | bytes] = []
        self._size = 0

    def blob(self) -> bytes:
        """Return the bytes of all arrays; they are copied only here, as a view has megabytes."""
        return b"".join(self._parts)

    def tree(self, value: Any) -> Any:
        """Return ``value`` as a tree of JSON types."""
        # Arrays and NumPy scalars
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, np.generic):
            return self.tree(value.item())

        # Containers
        if is_dataclass(value):
            return {f.name: self.tree(getattr(value, f.name)) for f in stored_fields(type(value))}
        if isinstance(value, tuple | list):
            return [self.tree(each) for each in value]

        # Plain values
        if isinstance(value, float) and not math.isfinite(value):
            return repr(value)
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"cannot record a {type(value).__name__}")

    def _array(self, array: Array) -> list[Any]:
        """Store ``array`` and return its type, shape, type on disk and offset."""
        if not self._shares or id(array) not in self._places:
            stored = _narrowed(array)
            self._places[id(array)] = [
                array.dtype.str, list(array.shape), stored.dtype.str, self._size
            ]  # fmt: skip
            self._alive.append(array)
            padding = bytes(-stored.nbytes % 8)
            self._parts += [np.ascontiguousarray(stored).data, padding]
            self._size += stored.nbytes + len(padding)
        return self._places[id(array)]


def stored_fields(cls: type) -> tuple[Field[Any], ...]:
    """Return the fields of the dataclass ``cls`` that its constructor takes."""
    return tuple(f for f in fields(cls) if f.init and f.metadata.get("stored", True))


def pack(value: Any) -> Packed:
    """Return ``value``, a nest of dataclasses, tuples, arrays and scalars, as JSON and bytes."""
    packer = _Packer()
    tree = packer.tree(value)
    return json.dumps(tree, separators=(",", ":"), allow_nan=False), packer.blob()


def are_equal(a: Any, b: Any) -> bool:
    """Return whether two values that ``pack`` takes are equal bit by bit.

    It does not matter which of their arrays are one object, which a file may have written apart.
    """
    trees, blobs = [], []
    for value in (a, b):
        packer = _Packer(shares=False)
        trees.append(packer.tree(value))
        blobs.append(packer.blob())
    return bool(trees[0] == trees[1] and blobs[0] == blobs[1])


def pack_fields(value: Any, unlike: Any = None) -> Packed:
    """Return the fields of the dataclass ``value`` that are not the same objects in ``unlike``."""
    packer = _Packer()
    changed = {
        f.name: packer.tree(getattr(value, f.name))
        for f in stored_fields(type(value))
        if unlike is None or getattr(value, f.name) is not getattr(unlike, f.name)
    }
    return json.dumps(changed, separators=(",", ":"), allow_nan=False), packer.blob()


def unpack(hint: Any, packed: Packed) -> Any:
    """Return the value of type ``hint`` that was packed, with read-only arrays.

    Raises:
        FileError: The content is not of this type.
    """
    text, blob = packed
    try:
        return _Unpacker(blob).value(hint, parse_json(text))
    except _DECODE_ERRORS as error:
        name = getattr(hint, "__name__", hint)
        raise FileError(f"no valid {name} in the file: {error}") from None


def unpack_fields(cls: type, packed: Packed) -> dict[str, Any]:
    """Return the fields of ``cls`` that were packed, by name.

    Raises:
        FileError: The content is not of this type.
    """
    text, blob = packed
    try:
        return _Unpacker(blob).fields(cls, parse_json(text))
    except _DECODE_ERRORS as error:
        raise FileError(f"no valid {cls.__name__} in the file: {error}") from None


_DECODE_ERRORS = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
    TwinError,
)
"""Errors raised where the content does not match the type hint, or is refused by its class."""
_NUMBERS = "biuf"
"""Kinds of arrays that are stored: bool, integer and floating point."""


def is_array(hint: Any) -> bool:
    """Return whether ``hint`` is that of an array.

    Since NumPy 2.5 ``NDArray`` is a type alias on Python 3.12 and later, so its value is examined.
    """
    origin = get_origin(hint)
    return np.ndarray in (hint, origin, get_origin(getattr(origin, "__value__", None)))


class _Unpacker:
    """Restores values; an array that was stored once is restored as one shared array."""

    def __init__(self, blob: bytes) -> None:
        self._blob = blob
        self._left = len(blob)
        self._arrays: dict[str, Array] = {}

    def value(self, hint: Any, tree: Any) -> Any:
        """Return the value of type ``hint`` that ``tree`` encodes."""
        # Arrays, optional values and tuples
        origin = get_origin(hint)
        if is_array(hint):
            return self._array(tree)
        if origin in (Union, types.UnionType):
            (inner,) = (each for each in get_args(hint) if each is not types.NoneType)
            return None if tree is None else self.value(inner, tree)
        if origin is tuple:
            return self._tuple(get_args(hint), tree)

        # Dataclasses and plain values
        if is_dataclass(hint):
            assert isinstance(hint, type)
            return hint(**self.fields(hint, tree))
        return _plain(hint, tree)

    def fields(self, cls: type, tree: Any) -> dict[str, Any]:
        """Return the fields of ``cls`` that are in ``tree``."""
        hints, former = _hints(cls), former_names(cls)
        known = {f.name for f in stored_fields(cls)}
        result = {}
        for name, each in tree.items():
            today, values = former.get(name, (name, {}))
            if today in known:
                each = values.get(each, each) if isinstance(each, str) else each
                result[today] = self.value(hints[today], each)
        return result

    def _tuple(self, hints: tuple[Any, ...], tree: Any) -> tuple[Any, ...]:
        if len(hints) == 2 and hints[1] is Ellipsis:
            return tuple(self.value(hints[0], each) for each in tree)
        return tuple(self.value(hint, each) for hint, each in zip(hints, tree, strict=True))

    def _array(self, place: Any) -> Array:
        """Return the array at ``place``; arrays do not overlap, so their sum is bounded."""
        if str(place) not in self._arrays:
            dtype, shape, stored, offset = place
            if not all(type(n) is int and n >= 0 for n in (*shape, offset)):
                raise ValueError(f"an array {place} of no whole size at no whole place")
            self._left -= math.prod(shape) * np.dtype(stored).itemsize
            if self._left < 0 or {np.dtype(dtype).kind, np.dtype(stored).kind} - set(_NUMBERS):
                raise ValueError(f"an array {place} that does not fit into the data")
            flat = np.frombuffer(self._blob, np.dtype(stored), math.prod(shape), offset)
            array = flat.reshape(shape).astype(dtype, copy=False)
            array.flags.writeable = False
            self._arrays[str(place)] = array
        return self._arrays[str(place)]


def _plain(hint: Any, tree: Any) -> Any:
    """Return the plain value ``tree`` of type ``hint``.

    Raises:
        TypeError: It is of another type.
    """
    if hint is float and isinstance(tree, int | float | str):
        return float(tree)
    known = get_origin(hint) is not Literal and hint in (bool, int, str)
    fits = type(tree) is hint if known else tree in get_args(hint) or hint is Any
    if not fits:
        raise TypeError(f"{tree!r:.40} is no {getattr(hint, '__name__', hint)}")
    return tree


def _narrowed(array: Array) -> Array:
    """Return integers in the smallest type that holds them; other arrays unchanged."""
    if array.dtype.kind not in "iu" or array.size == 0:
        return array
    low, high = int(array.min()), int(array.max())
    narrow = np.promote_types(np.min_scalar_type(low), np.min_scalar_type(high))
    # NumPy promotes a signed type and the largest unsigned one to floating point, which rounds.
    return array.astype(narrow) if narrow.kind in "iu" else array


@cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)
