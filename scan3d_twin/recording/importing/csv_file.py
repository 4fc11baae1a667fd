"""Reads CSV files: a reading or a line per row, with units in the names of the columns.

A reading per row::

    time_s,axis_deg,angle_deg,range_m
    0.0000,-90.00,-120.0,1.234

A line per row, all its readings after the first two columns::

    time_s,axis_deg,angle_deg,range_m,angle_deg,range_m, ...

``axis`` is the angle of the turning axis, left positive, ``angle`` that of the beam in the scan
plane, 0 ahead and up positive. Units: s, ms, us, ns; deg, rad; m, cm, mm. Columns ``line`` and
``sweep`` number lines and sweeps; others, such as intensities, are skipped, and ``time`` may be
missing. A range that is empty, 0, negative or nan is no return. Columns are separated by comma,
semicolon or tab; with semicolons decimals may have commas. Lines that begin with # are comments,
but ``# beam_s: 0.0001`` states the time from one beam of a row to the next.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.limits import how_to_raise, scaled
from scan3d_twin.recording.importing.readings import (
    MAX_READINGS,
    Readings,
    clean_ranges,
    number_lines,
)

MAX_SIZE = 300_000_000
"""Largest file [bytes]: ten million readings. Reading it takes ten times the memory."""
MAX_COLUMNS = 100_000
"""Most columns of a row: a line of 50,000 beams."""
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "axis": {"deg": math.pi / 180.0, "rad": 1.0},
    "angle": {"deg": math.pi / 180.0, "rad": 1.0},
    "range": {"m": 1.0, "cm": 0.01, "mm": 0.001},
}
"""Units of each column, and their size in SI units."""
EXAMPLE = "time_s,axis_deg,angle_deg,range_m"
_BEAM_TIME = re.compile(r"#\s*beam_(s|ms|us|ns)\s*[:=]\s*(\S+)")


@dataclass(frozen=True)
class _Columns:
    """What the columns of a file are.

    Attributes:
        places: Index of the column of each quantity.
        units: Size of its unit in SI units.
        pairs: Index of the first of the columns angle, range, angle, range ...; None where each
            row is one reading.
    """

    places: dict[str, int]
    units: dict[str, float]
    pairs: int | None


def read_csv(path: Path) -> list[Readings]:
    """Return the readings in the CSV file at ``path``, one object for each numbered sweep.

    Raises:
        FileError: It cannot be read, is too large, or is not in this format.
    """
    # Read the text
    try:
        if path.stat().st_size > scaled(MAX_SIZE):
            raise FileError(f"{path} is larger than {MAX_SIZE / 1e6:g} MB; {how_to_raise()}")
        rows = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FileError(f"{path} is no text in UTF-8; is it a CSV file?") from None

    # Find header and data
    beam_time = _find_beam_time(rows, path)
    numbered = [(k, row) for k, row in enumerate(rows, 1) if row.strip() and row[:1] != "#"]
    if len(numbered) < 2:
        raise FileError(f"{path} holds no data; it begins with a header: {EXAMPLE}")
    header, data = numbered[0][1], numbered[1:]
    separator = next((each for each in ";\t" if each in header), ",")
    columns = _understand(header.split(separator), path)
    values = _parse(data, separator, columns, path)
    readings = _by_line(values, columns, beam_time, path) if columns.pairs is not None else (
        _by_reading(values, columns, path)
    )  # fmt: skip
    return _split_numbered(readings, values, columns, path)


def _find_beam_time(rows: Sequence[str], path: Path) -> float:
    """Return the time between two beams of a row that a comment states [s]; 0 without one."""
    for row in rows:
        if row[:1] == "#" and (found := _BEAM_TIME.match(row)):
            try:
                return float(found[2]) * UNITS["time"][found[1]]
            except ValueError:
                raise FileError(f"{path}: {row.strip()!r} states no time") from None
    return 0.0


def _understand(names: list[str], path: Path) -> _Columns:
    """Return what the columns are by their ``names``."""
    places: dict[str, int] = {}
    units: dict[str, float] = {}
    pairs = None
    for k, name in enumerate(each.strip().strip('"').lower() for each in names):
        kind, _, unit = name.partition("_")
        if name in ("line", "sweep"):
            places.setdefault(name, k)
        elif kind in UNITS:
            if unit not in UNITS[kind]:
                known = ", ".join(f"{kind}_{each}" for each in UNITS[kind])
                raise FileError(f"{path}: column {name!r} states no known unit; known: {known}")
            if kind in places and kind in ("angle", "range"):
                pairs = places["angle"]
            places.setdefault(kind, k)
            units.setdefault(kind, UNITS[kind][unit])
    for kind in ("axis", "angle", "range"):
        if kind not in places:
            raise FileError(f"{path}: no column {kind}; the header is such as {EXAMPLE}")
    return _Columns(places, units, pairs)


def _parse(
    data: Sequence[tuple[int, str]], separator: str, columns: _Columns, path: Path
) -> FloatArray:
    """Return the numbers of all rows (n, k); NaN where a field is empty or missing."""
    # Count the fields
    counts = [row.count(separator) for _, row in data]
    most, last = max(counts), max(columns.places.values())
    if most >= MAX_COLUMNS or len(data) * (most + 1) > scaled(2 * MAX_READINGS):
        raise FileError(f"{path} holds more than {MAX_READINGS:.0e} readings; {how_to_raise()}")

    # Make all rows alike
    empty = re.compile(rf"(?<=\{separator})(?=\s*(\{separator}|$))|^(?=\s*\{separator})")
    alike = []
    for (number, row), count in zip(data, counts, strict=True):
        if count < (last if columns.pairs is None else columns.places["axis"]):
            raise FileError(f"{path}, line {number}: {count + 1} columns, too few")
        row = row.replace(",", ".") if separator == ";" else row
        row = row.rstrip() + separator * (most - count)
        row = f"{row}nan" if row[-1:] == separator else row
        if separator * 2 in row or row[:1] == separator or " " in row:
            row = empty.sub("nan", row)
        alike.append(row)

    # Parse them
    try:
        return np.loadtxt(alike, delimiter=separator, ndmin=2, comments=None)
    except ValueError as error:
        found = re.search(r"at row (\d+)", str(error))
        number = data[min(int(found[1]), len(data) - 1)][0] if found else data[0][0]
        reason = str(error).partition(" at row")[0]
        raise FileError(f"{path}, line {number}: {reason}") from None


def _by_reading(values: FloatArray, columns: _Columns, path: Path) -> Readings:
    """Return the readings of a file with a reading per row."""
    # Convert the columns
    si = {
        kind: values[:, columns.places[kind]] * unit
        for kind, unit in columns.units.items()
    }  # fmt: skip
    _require_finite({kind: each for kind, each in si.items() if kind != "range"}, path)

    # Number the lines
    if "line" in columns.places:
        numbers = values[:, columns.places["line"]]
        _require_finite({"line": numbers}, path)
        lines = np.concatenate([[0], np.cumsum(np.diff(numbers) != 0)])
    else:
        lines = number_lines(si["angle"])
    return Readings(
        str(path),
        np.asarray(lines, dtype=np.int64),
        si.get("time"),
        si["axis"],
        si["angle"],
        clean_ranges(si["range"], str(path)),
    )


def _by_line(values: FloatArray, columns: _Columns, beam_time: float, path: Path) -> Readings:
    """Return the readings of a file with a line per row."""
    # Take the pairs apart
    assert columns.pairs is not None
    first, swapped = columns.places["angle"], columns.places["range"] < columns.places["angle"]
    first = min(first, columns.places["range"])
    body = values[:, first : first + 2 * ((values.shape[1] - first) // 2)]
    angles, ranges = (body[:, k::2] for k in ((1, 0) if swapped else (0, 1)))
    present = np.isfinite(angles)
    lines, beams = np.nonzero(present)

    # Interpolate the axis at the time of each beam
    axis = values[:, columns.places["axis"]] * columns.units["axis"]
    times = None
    if "time" in columns.places:
        stamps = values[:, columns.places["time"]] * columns.units["time"]
        _require_finite({"time": stamps, "axis": axis}, path)
        times = stamps[lines] + beam_time * beams
        axis = _interpolate(times, stamps, np.unwrap(axis))
    else:
        _require_finite({"axis": axis}, path)
        axis = axis[lines]
    return Readings(
        str(path),
        np.asarray(lines, dtype=np.int64),
        times,
        axis,
        angles[present] * columns.units["angle"],
        clean_ranges(ranges[present] * columns.units["range"], str(path)),
    )


def _interpolate(times: FloatArray, stamps: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the axis at ``times`` (n,), by its angle at ``stamps`` (m,), and beyond the last."""
    order = np.argsort(stamps, kind="stable")
    stamps, axis = stamps[order], axis[order]
    result = np.interp(times, stamps, axis)
    beyond = times > stamps[-1]
    if beyond.any() and len(stamps) > 1 and stamps[-1] > stamps[-2]:
        rate = (axis[-1] - axis[-2]) / (stamps[-1] - stamps[-2])
        result[beyond] = axis[-1] + rate * (times[beyond] - stamps[-1])
    return np.asarray(result)


def _require_finite(columns: dict[str, FloatArray], path: Path) -> None:
    for kind, values in columns.items():
        if not np.all(np.isfinite(values)) or np.max(np.abs(values), initial=0.0) > 1e12:
            raise FileError(f"{path}: the column {kind} has fields that are no number")


def _split_numbered(
    readings: Readings, values: FloatArray, columns: _Columns, path: Path
) -> list[Readings]:
    """Return the readings by the column ``sweep``, all of them where there is none."""
    if "sweep" not in columns.places:
        return [readings]
    numbers = values[:, columns.places["sweep"]]
    _require_finite({"sweep": numbers}, path)
    if columns.pairs is not None:
        numbers = numbers[readings.lines]
    ends: IntArray = np.concatenate([[0], np.cumsum(np.diff(numbers) != 0)])
    return [
        readings.select(ends == k, f"{path}, sweep {numbers[np.argmax(ends == k)]:g}")
        for k in range(int(ends[-1]) + 1)
    ]
