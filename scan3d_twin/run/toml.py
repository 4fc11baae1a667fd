"""TOML from elsewhere, parsed within limits: every failure is one line.

``tomllib`` takes time that grows with the square of a dotted key's length, and recurses once per
bracket.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.limits import how_to_raise, scaled

MAX_SIZE = 1_000_000
"""Largest text [bytes]: all options of a run take 4 kB, the largest suite of experiments 7 kB."""
MAX_DOTS = 64
"""Most dots of a key; our deepest key has two."""
_SEPARATORS = re.compile(r"[=,\n\[{]")
"""What ends a key or a number, so that between two of them lies at most one key."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of the TOML file ``path``.

    Raises:
        FileError: It is missing, unreadable, too large or not TOML.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(scaled(MAX_SIZE) + 1)
        return parse_toml(data.decode("utf-8"), path)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is not valid TOML: {error}") from error


def parse_toml(text: str, source: object) -> dict[str, Any]:
    """Return the content of a TOML ``text``; ``source`` says in messages where it comes from.

    Raises:
        FileError: It is too large or not TOML.
    """
    if len(text) > scaled(MAX_SIZE):
        raise FileError(
            f"{source} holds more than {scaled(MAX_SIZE) / 1e6:g} MB of TOML; {how_to_raise()}"
        )
    if any(part.count(".") > MAX_DOTS for part in _SEPARATORS.split(text)):
        raise FileError(f"{source} is not valid TOML for options: a key of over {MAX_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise FileError(f"{source} is not valid TOML for options: nested too deeply") from None
    except ValueError as error:
        raise FileError(f"{source} is not valid TOML: {error}") from error
