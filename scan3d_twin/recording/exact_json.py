"""Frozen dataclasses as JSON and bytes that give back the same bits.

Read from the fields and their type hints, so that a field added to a dataclass is kept without
another word: what an older file lacks gets the field's default, what it has too much is left out.
"""

from __future__ import annotations

import json
import math
import types
from dataclasses import Field, fields, is_dataclass
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.options import former_names

Packed = tuple[str, bytes]
"""A JSON text, and the arrays it points into."""
Array = np.ndarray[Any, Any]


class _Packer:
    """Collects the arrays of one value; an array that occurs twice is stored once."""

    def __init__(self) -> None:
        self.blob = bytearray()
        self._places: dict[int, list[Any]] = {}
        self._alive: list[Array] = []

    def tree(self, value: Any) -> Any:
        """Return ``value`` as what JSON knows."""
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, np.generic):
            return self.tree(value.item())
        if is_dataclass(value):
            return {f.name: self.tree(getattr(value, f.name)) for f in stored_fields(type(value))}
        if isinstance(value, tuple | list):
            return [self.tree(each) for each in value]
        if isinstance(value, float) and not math.isfinite(value):
            return repr(value)
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"cannot record a {type(value).__name__}")

    def _array(self, array: Array) -> list[Any]:
        """Return where ``array`` lies: its type, shape, type on disk and offset."""
        if id(array) not in self._places:
            stored = _narrowed(array)
            self._places[id(array)] = [
                array.dtype.str, list(array.shape), stored.dtype.str, len(self.blob)
            ]  # fmt: skip
            self._alive.append(array)
            self.blob += stored.tobytes()
            self.blob += bytes(-len(self.blob) % 8)
        return self._places[id(array)]


def stored_fields(cls: type) -> tuple[Field[Any], ...]:
    """Return the fields of the dataclass ``cls`` that make its value."""
    return tuple(f for f in fields(cls) if f.init)


def pack(value: Any) -> Packed:
    """Return ``value``: a dataclass, tuple, array or scalar, as deep as it goes."""
    packer = _Packer()
    tree = packer.tree(value)
    return json.dumps(tree, separators=(",", ":"), allow_nan=False), bytes(packer.blob)


def pack_fields(value: Any, unlike: Any = None) -> Packed:
    """Return the fields of the dataclass ``value`` that are not the very objects of ``unlike``."""
    packer = _Packer()
    changed = {
        f.name: packer.tree(getattr(value, f.name))
        for f in stored_fields(type(value))
        if unlike is None or getattr(value, f.name) is not getattr(unlike, f.name)
    }
    return json.dumps(changed, separators=(",", ":"), allow_nan=False), bytes(packer.blob)


def unpack(hint: Any, packed: Packed) -> Any:
    """Return the value of type ``hint`` that was packed; its arrays refuse writes.

    Raises:
        FileError: It is no such value.
    """
    text, blob = packed
    try:
        return _Unpacker(blob).value(hint, json.loads(text))
    except _WRONG as error:
        name = getattr(hint, "__name__", hint)
        raise FileError(f"no valid {name} in the file: {error}") from None


def unpack_fields(cls: type, packed: Packed) -> dict[str, Any]:
    """Return the fields of ``cls`` that were packed, by name.

    Raises:
        FileError: They are not.
    """
    text, blob = packed
    try:
        return _Unpacker(blob).fields(cls, json.loads(text))
    except _WRONG as error:
        raise FileError(f"no valid {cls.__name__} in the file: {error}") from None


_WRONG = (ValueError, TypeError, KeyError, IndexError, AttributeError)
"""What values of another shape than the hint's run into."""


def is_array(hint: Any) -> bool:
    """Tell whether a hint is that of an array.

    Since NumPy 2.5 ``NDArray`` is an alias on Python 3.12 and later: what it stands for is asked.
    """
    origin = get_origin(hint)
    return np.ndarray in (hint, origin, get_origin(getattr(origin, "__value__", None)))


class _Unpacker:
    """Gives values back; an array that was stored once is one array again."""

    def __init__(self, blob: bytes) -> None:
        self._blob = blob
        self._arrays: dict[str, Array] = {}

    def value(self, hint: Any, tree: Any) -> Any:
        """Return what ``tree`` stands for as a ``hint``."""
        origin = get_origin(hint)
        if is_array(hint):
            return self._array(tree)
        if origin in (Union, types.UnionType):
            (inner,) = (each for each in get_args(hint) if each is not types.NoneType)
            return None if tree is None else self.value(inner, tree)
        if origin is tuple:
            return self._tuple(get_args(hint), tree)
        if is_dataclass(hint):
            assert isinstance(hint, type)
            return hint(**self.fields(hint, tree))
        return float(tree) if hint is float else tree

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
        if str(place) not in self._arrays:
            dtype, shape, stored, offset = place
            flat = np.frombuffer(self._blob, np.dtype(stored), math.prod(shape), offset)
            array = flat.reshape(shape).astype(dtype, copy=False)
            array.flags.writeable = False
            self._arrays[str(place)] = array
        return self._arrays[str(place)]


def _narrowed(array: Array) -> Array:
    """Return whole numbers in the smallest type that holds them; everything else as it is."""
    if array.dtype.kind not in "iu" or array.size == 0:
        return array
    low, high = int(array.min()), int(array.max())
    narrow = np.promote_types(np.min_scalar_type(low), np.min_scalar_type(high))
    # Of a signed type and the largest unsigned one NumPy makes floating point, which rounds.
    return array.astype(narrow) if narrow.kind in "iu" else array


@cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)
