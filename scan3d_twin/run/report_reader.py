"""Reads ``report.json`` files, which may come from someone else or from another version."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.limits import scaled
from scan3d_twin.run.report import Report, report_schema
from scan3d_twin.run.strict_json import parse_json

MAX_SIZE = 1_000_000
"""Largest file [bytes]: a report of 100 views takes 40 kB."""
_TYPES: dict[str, tuple[type, ...]] = {
    "array": (list,),
    "boolean": (bool,),
    "integer": (int,),
    "null": (type(None),),
    "number": (int, float),
    "object": (dict,),
    "string": (str,),
}
"""Python types of those of JSON schema."""


def read_report(path: Path) -> Report:
    """Return the report in ``path``: those of its fields that the schema knows, as it wants them.

    A report of another version may lack fields.

    Raises:
        FileNotFoundError: There is none.
        FileError: It cannot be read, or holds something else than a report.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(scaled(MAX_SIZE) + 1)
        if len(content) > scaled(MAX_SIZE):
            raise ValueError(f"more than {scaled(MAX_SIZE) / 1e6:g} MB")
        report: Report = _fit(parse_json(content), report_schema(), "the report")
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileError(f"{path} is no report of twin: {error}") from None
    if any("view" not in row for row in report.get("registration", [])):
        raise FileError(f"{path} is no report of twin: a registration of no view")
    return report


def _fit(value: Any, schema: dict[str, Any], name: str) -> Any:
    """Return ``value`` as ``schema`` describes it; a whole number may be written as 2.0.

    Raises:
        ValueError: It is of another type, or out of bounds.
    """
    # Check the type
    kinds = schema.get("type", "string")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if "integer" in kinds and isinstance(value, float) and value.is_integer():
        value = int(value)
    if type(value) not in {each for kind in kinds for each in _TYPES[kind]}:
        raise ValueError(f"{name} is {value!r:.40}")

    # Check what is in it
    if isinstance(value, dict):
        known = schema["properties"]
        return {key: _fit(value[key], known[key], key) for key in known if key in value}
    if isinstance(value, list):
        return [_fit(each, schema["items"], f"an item of {name}") for each in value]
    if isinstance(value, int | float) and not _is_within(value, schema):
        raise ValueError(f"{name} is {value!r:.40}")
    return value


def _is_within(value: float, schema: dict[str, Any]) -> bool:
    """Return whether the number ``value`` is finite and within the bounds of ``schema``."""
    try:
        finite = math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False
    return finite and schema.get("minimum", value) <= value <= schema.get("maximum", value)
