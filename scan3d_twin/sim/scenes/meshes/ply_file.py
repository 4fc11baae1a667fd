"""The geometry of a PLY file: vertices, polygons of any size, triangle strips.

After G. Turk, "The PLY Polygon File Format", 1994: a header that names the elements and their
properties, then their values, row by row, as text or as numbers of either byte order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.sim.scenes.meshes.polygons import check_indices, triangulate

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
"""NumPy's types by their names in PLY."""
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MAX_HEADER = 65_536
"""Largest header [bytes]."""
MAX_INTEGER = 2.0**53
"""Largest integer of which a double holds all below."""
STRIP_END = -1
"""Index that ends one of several triangle strips in one list."""

Column = Any
"""Values of a property: an array (n,), or a list of arrays of a list property."""


@dataclass
class Element:
    """An element of the header.

    Attributes:
        name: Such as vertex or face.
        count: Number of rows.
        properties: Name, type, and type of the count of a list or "" (NumPy's types).
    """

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read_ply(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices (n, 3) and triangles (m, 3) of a PLY file.

    Raises:
        SceneError: It is no PLY file, ends early, or refers to vertices that it does not have.
    """
    data = path.read_bytes()
    order, elements, start = _read_header(data, path)
    try:
        values = _read_text(data[start:], elements) if order == "" else {}
        if order:
            values = _read_binary(memoryview(data)[start:], elements, order)
        rows = values["vertex"]
        vertices = np.stack([np.asarray(rows[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    except (KeyError, ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"{path} is damaged: {_reason(error)}; export it again") from None
    polygons = _lists(values.get("face", {}), ("vertex_indices", "vertex_index"))
    strips = _lists(values.get("tristrips", {}), ("vertex_indices", "vertex_index"))
    triangles = np.empty((0, 3), np.int64)
    if len(polygons):
        triangles = triangulate(vertices, polygons, str(path))
    if len(strips):
        triangles = np.concatenate([triangles, *(_strip_triangles(strip) for strip in strips)])
    check_indices(triangles.ravel(), len(vertices), str(path))
    return vertices, triangles


def _reason(error: Exception) -> str:
    return f"it has no {error}" if isinstance(error, KeyError) else "it ends early or is no text"


def _check_count(count: int) -> int:
    """Return ``count``, which must not be negative."""
    if count < 0:
        raise ValueError("a count is negative")
    return count


def _read_header(data: bytes, path: Path) -> tuple[str, list[Element], int]:
    """Return byte order ("" for text), elements, and where their values begin."""
    # Find the end of the header
    mark = data.find(b"end_header", 0, MAX_HEADER)
    end = data.find(b"\n", mark) + 1 if mark >= 0 else 0
    lines = [line.split() for line in data[: max(mark, 0)].decode("latin-1").splitlines()]
    if end == 0 or lines[:1] != [["ply"]]:
        raise SceneError(f"{path} is not a PLY file: it has no header from 'ply' to 'end_header'")

    # Read its lines
    order, elements = None, []
    try:
        for words in lines[1:]:
            match words:
                case ["format", kind, *_]:
                    order = ORDERS[kind]
                case ["element", name, count]:
                    elements.append(Element(name, _check_count(int(count))))
                case ["property", "list", size, kind, name]:
                    elements[-1].properties.append((name, TYPES[kind], TYPES[size]))
                case ["property", kind, name]:
                    elements[-1].properties.append((name, TYPES[kind], ""))
    except (KeyError, ValueError, IndexError):
        raise SceneError(f"{path}: line {' '.join(words)!r} of its header is not PLY") from None
    if order is None:
        raise SceneError(f"{path}: its header states no format")
    return order, elements, end


def _read_text(data: bytes, elements: list[Element]) -> dict[str, dict[str, Column]]:
    """Return the columns of all elements by name, from text."""
    numbers = np.array(data.split(), dtype=np.float64)
    at, result = 0, dict[str, dict[str, Column]]()
    for element in elements:
        width = len(element.properties)
        if not any(size for *_, size in element.properties):
            table = numbers[at : at + element.count * width].reshape(element.count, width)
            result[element.name] = {p[0]: table[:, k] for k, p in enumerate(element.properties)}
            at += table.size
            continue
        rows: dict[str, list[Any]] = {name: [] for name, *_ in element.properties}
        for _ in range(element.count):
            for name, _, size in element.properties:
                count = _check_count(int(numbers[at])) if size else 1
                at += 1 if size else 0
                value = numbers[at : at + count]
                if len(value) != count:
                    raise ValueError("it ends early")
                rows[name].append(value if size else value[0])
                at += count
        result[element.name] = rows
    return result


def _read_binary(
    data: memoryview, elements: list[Element], order: str
) -> dict[str, dict[str, Column]]:
    """Return the columns of all elements by name, from numbers of a byte ``order``."""
    at, result = 0, {}
    for element in elements:
        table, at = _read_rows(data, at, element, order)
        result[element.name] = table
    return result


def _read_rows(
    data: memoryview, at: int, element: Element, order: str
) -> tuple[dict[str, Column], int]:
    """Return the columns of an ``element`` that begins ``at``, and where it ends."""
    # Read rows of one length at once: all lists are as long as the first ones
    kind, lists = _row_type(data, at, element, order)
    if element.count and len(data) >= at + kind.itemsize * element.count:
        table = np.frombuffer(data, kind, element.count, at)
        if all((table[f"{name} count"] == size).all() for name, size in lists.items()):
            columns = {name: table[name] for name, *_ in element.properties}
            return columns, at + kind.itemsize * element.count

    # Read rows of several lengths one by one
    rows: dict[str, list[Any]] = {name: [] for name, *_ in element.properties}
    for _ in range(element.count):
        for name, kind_name, size in element.properties:
            count = 1
            if size:
                count = _check_count(int(np.frombuffer(data, order + size, 1, at)[0]))
                at += np.dtype(size).itemsize
            value = np.frombuffer(data, order + kind_name, count, at) if count else np.empty(0, int)
            at += value.nbytes if count else 0
            rows[name].append(value if size else value[0])
    return rows, at


def _row_type(
    data: memoryview, at: int, element: Element, order: str
) -> tuple[np.dtype[Any], dict[str, int]]:
    """Return the type of a row whose lists are as long as in the first one, and these lengths."""
    parts: list[Any] = []
    lists = {}
    for name, kind, size in element.properties:
        if size:
            before = np.dtype(parts).itemsize
            known = element.count and len(data) >= at + before + np.dtype(size).itemsize
            count = int(np.frombuffer(data, order + size, 1, at + before)[0]) if known else 0
            lists[name] = max(count, 0)
            parts.append((f"{name} count", order + size))
            parts.append((name, order + kind, (lists[name],)))
        else:
            parts.append((name, order + kind))
    return np.dtype(parts), lists


def _lists(columns: dict[str, Column], names: tuple[str, ...]) -> list[IntArray] | IntArray:
    """Return the lists of the first of ``names`` among ``columns``, (n, k) if of one size."""
    for name in names:
        rows = columns.get(name)
        if isinstance(rows, np.ndarray) and rows.ndim == 2:
            return _to_integers(rows)
        if name in columns:
            return [np.atleast_1d(_to_integers(row)) for row in columns[name]]
    return []


def _to_integers(numbers: Column) -> IntArray:
    """Return ``numbers`` as integers; what is none in 64 bits is the index of no vertex."""
    known = np.nan_to_num(np.asarray(numbers, dtype=np.float64), nan=MAX_INTEGER)
    result: IntArray = known.clip(-MAX_INTEGER, MAX_INTEGER).astype(np.int64)
    return result


def _strip_triangles(strip: IntArray) -> IntArray:
    """Return the triangles (m, 3) of one list of strips, wound alike."""
    ends = np.flatnonzero(strip == STRIP_END)
    parts = []
    for piece in np.split(strip, ends):
        piece = piece[piece != STRIP_END]
        if len(piece) > 2:
            triangles = np.stack([piece[:-2], piece[1:-1], piece[2:]], axis=1)
            triangles[1::2] = triangles[1::2, ::-1]
            parts.append(triangles)
    return np.concatenate(parts) if parts else np.empty((0, 3), np.int64)
