"""Fields of a configuration dataclass: defaults with bounds, and the checks of their values.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from keyword import iskeyword
from numbers import Integral, Real
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from scan3d_twin.core.errors import ConfigError, UnknownNameError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Bounds:
    """The range of values that a number may have.

    Attributes:
        low: Lower bound, in the number's own unit.
        high: Upper bound, which is allowed.
        open: Whether ``low`` is excluded.
    """

    low: float
    high: float
    open: bool

    def find_violation(self, value: float) -> str:
        """Return the bound that ``value`` violates, such as ``<= 1``; empty if it violates none."""
        if not math.isfinite(value):
            return "finite"
        if value < self.low or (self.open and value == self.low):
            return f"{'>' if self.open else '>='} {self.low:g}"
        return f"<= {self.high:g}" if value > self.high else ""


def number(
    default: T,
    least: float | None = None,
    most: float = 1.0,
    *,
    above: float = 0.0,
) -> T:
    """Return a dataclass field for a number with bounds; > 0 and <= 1 if none are stated.

    Args:
        default: Value of the field by default.
        least: Inclusive lower bound; None where ``above`` is the bound.
        most: Inclusive upper bound.
        above: Exclusive lower bound.
    """
    bounds = Bounds(above if least is None else least, most, least is None)
    result: T = field(default=default, metadata={"bounds": bounds})
    return result


def renamed(default: T, formerly: str, values: Mapping[str, str] | None = None) -> T:
    """Return a dataclass field for an option that older files call ``formerly``.

    Args:
        default: Value of the field by default.
        formerly: Its name in older files.
        values: Today's values by the names they have in older files.
    """
    result: T = field(default=default, metadata={"formerly": formerly, "values": values or {}})
    return result


def former_names(cls: type) -> dict[str, tuple[str, Mapping[str, str]]]:
    """Return today's name and values of each renamed field of ``cls`` by its former name."""
    return {
        f.metadata["formerly"]: (f.name, f.metadata["values"])
        for f in fields(cls)
        if "formerly" in f.metadata
    }


def option_key(name: str) -> str:
    """Return the key of the field ``name`` in files: ``lambda`` for ``lambda_``."""
    return name.rstrip("_")


def field_name(key: str) -> str:
    """Return the field of an option by its ``key`` in files: ``lambda_`` for ``lambda``."""
    return f"{key}_" if iskeyword(key) else key


def check_options(options: Any, section: str = "") -> None:
    """Check every field of the dataclass ``options`` against its type and bounds.

    Args:
        options: The dataclass, from its ``__post_init__``.
        section: Name of its table in a configuration file, for messages; empty at the top level.

    Raises:
        ConfigError: A value has the wrong type, is none of its choices, not finite or out of
            bounds.
    """
    where = f"{section}." if section else ""
    for name, key, hint, choices, bounds in _rules(type(options)):  # type: ignore[arg-type]
        _convert_number(options, name, hint)
        _check(where + key, getattr(options, name), hint, choices, bounds)


def _convert_number(options: Any, name: str, hint: Any) -> None:
    """Make a number of another library, such as ``numpy.int64``, one of Python's own."""
    value = getattr(options, name)
    if isinstance(value, bool | int | float):
        return
    if hint is int and isinstance(value, Integral):
        object.__setattr__(options, name, int(value))
    elif hint is float and isinstance(value, Real):
        object.__setattr__(options, name, float(value))


@cache
def _rules(cls: Any) -> tuple[tuple[str, str, Any, tuple[Any, ...], Bounds | None], ...]:
    """Return name, key, type, choices (empty: any) and bounds of each field of ``cls``."""
    hints = get_type_hints(cls)
    choices = {
        name: get_args(hint) if get_origin(hint) is Literal else () for name, hint in hints.items()
    }
    return tuple(
        (f.name, option_key(f.name), hints[f.name], choices[f.name], f.metadata.get("bounds"))
        for f in fields(cls)
    )


def repr_options(options: Any) -> str:
    """Return the call that builds ``options``: only the fields that are not the default."""
    changes = []
    for f in fields(options):
        default = f.default if f.default_factory is MISSING else f.default_factory()
        value = getattr(options, f.name)
        if value != default:
            changes.append(f"{f.name}={value!r}")
    return f"{type(options).__name__}({', '.join(changes)})"


def _check(
    name: str, value: Any, hint: Any, choices: tuple[Any, ...], bounds: Bounds | None
) -> None:
    if choices:
        if value not in choices:
            listed = ", ".join(str(choice) for choice in choices)
            raise ConfigError(f"{name} must be one of {listed}; got {value!r}")
        return
    expected = (int, float) if hint is float else hint
    if not isinstance(value, expected) or (isinstance(value, bool) and hint is not bool):
        raise ConfigError(f"{name} must be {_WORDS.get(hint, hint.__name__)}, got {value!r}")
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise ConfigError(f"{name} must be finite, got a number of {value.bit_length()} bits")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name} must be finite, got {value:g}")
    if bounds is not None and (wanted := bounds.find_violation(value)):
        raise ConfigError(f"{name} must be {wanted}, got {value:g}")


_WORDS: Mapping[Any, str] = {
    float: "a number", int: "a whole number", str: "text", bool: "true or false"
}  # fmt: skip


def parse_options(cls: type[T], words: Iterable[str], section: str) -> T:
    """Return the dataclass ``cls`` with the values that ``words`` such as ``step=40`` state.

    Args:
        cls: Every field has a default; numbers, texts and ``true`` or ``false``.
        words: One option each.
        section: What the options belong to, for messages.

    Raises:
        ConfigError: A word is no option, or its value is of the wrong type or out of bounds.
    """
    hints, values = get_type_hints(cls), {}
    for word in words:
        name, found, text = word.partition("=")
        if not found:
            raise ConfigError(f"{section}: an option is NAME=VALUE, got {word!r}")
        if name not in hints:
            raise UnknownNameError(f"option of {section}", name, hints)
        values[name] = _parse(f"{section}.{name}", text, hints[name])
    options = cls(**values)
    check_options(options, section)
    return options


def _parse(name: str, text: str, hint: Any) -> Any:
    """Return ``text`` as a value of the type ``hint``."""
    if hint is bool:
        if text not in ("true", "false"):
            raise ConfigError(f"{name} must be true or false, got {text!r}")
        return text == "true"
    if hint not in (int, float):
        return text
    try:
        return hint(text)
    except ValueError:
        raise ConfigError(f"{name} must be {_WORDS[hint]}, got {text!r}") from None
