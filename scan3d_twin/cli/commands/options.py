"""``twin options``: the options of the configuration, too many for a help page."""

from __future__ import annotations

import json as json_module
import shutil
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import fields
from itertools import groupby
from typing import Any, Literal, get_args, get_origin

from scan3d_twin.cli.defaults import default_settings, format_value
from scan3d_twin.cli.dotted import DottedOption, dotted_fields
from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.options import Bounds
from scan3d_twin.sim.config import TwinConfig

USE = (
    "For `twin sim`, `real`, `bench` and `replay`, in SI units and radians. Ways to set one: "
    "--planning.eta-min 0.3, planning.eta_min = 0.3 in a --config FILE, TWIN_PLANNING_ETA_MIN=0.3",
    "Options of `twin sim --help` have the same name in a FILE (--max-views is max_views), except: "
    "--lidar is lidar_model; --epsilon [mm] is planning.epsilon [m]; --scene, --mesh-scale, "
    "--mesh-up, --room, --world, --preset, --seed and --target are in section run (run.scene, "
    "...).",
)
"""How to set an option, in paragraphs."""
_TYPES: Mapping[Any, str] = {float: "FLOAT", int: "INT", bool: "BOOL", str: "STR"}


def options(section: str | None = None, /, *, json: bool = False) -> None:
    """List the options of the configuration, with their units, defaults and limits.

    Args:
        section: List this section only, such as planning.
        json: Print one JSON document.

    Raises:
        UnknownNameError: There is no such section.
    """
    found = list(dotted_fields(Config, TwinConfig))
    sections = {option.section for option in found}
    if section is not None and section not in sections:
        raise UnknownNameError("section", section, sections)
    wanted = [option for option in found if section in (None, option.section)]
    if json:
        print(json_module.dumps([_document(option) for option in wanted], indent=2))
        return
    print("\n".join(_wrap(paragraph) for paragraph in USE))
    for name, group in groupby(wanted, key=lambda option: option.section):
        print(f"\n{_heading(name)}")
        for option in group:
            print(_entry(option))


def default_of(option: DottedOption) -> Any:
    """Return the value of ``option`` in a run for which nothing is stated."""
    return getattr(_default_section(option.section), option.name)


def _default_section(name: str) -> Any:
    """Return the default settings of the section ``name``."""
    effective = default_settings()
    return getattr(effective.config if hasattr(effective.config, name) else effective.twin, name)


def _document(option: DottedOption) -> dict[str, Any]:
    bounds = option.bounds
    return {
        "option": option.flag,
        "key": option.key,
        "variable": option.variable,
        "type": _type(option),
        "default": default_of(option),
        "choices": list(_choices(option)),
        "limits": None if bounds is None else _limits(bounds),
        "help": option.doc,
    }


def _heading(section: str) -> str:
    """Return the headline of a section: its name and what it is about."""
    about, *_ = (type(_default_section(section)).__doc__ or "").splitlines()
    twin_only = section in {field.name for field in fields(TwinConfig)}
    return f"{section}: {about}" + (" Only in the twin." if twin_only else "")


def _entry(option: DottedOption) -> str:
    """Return an option as a line with its name and values, and below it what it means."""
    facts = "".join(f" [{fact}]" for fact in _facts(option))
    return f"  {option.flag} {_type(option)}{facts}\n{_wrap(option.doc, ' ' * 6)}"


def _wrap(text: str, indent: str = "") -> str:
    """Return ``text`` in lines that fit the terminal, each after ``indent``."""
    width = max(40, shutil.get_terminal_size().columns)
    return textwrap.fill(
        text, width, initial_indent=indent, subsequent_indent=indent,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _facts(option: DottedOption) -> Iterator[str]:
    if choices := _choices(option):
        yield f"choices: {', '.join(choices)}"
    yield f"default: {format_value(default_of(option))}"
    if option.bounds is not None:
        yield _limits(option.bounds)


def _limits(bounds: Bounds) -> str:
    return f"{'>' if bounds.open else '>='} {bounds.low:g}, <= {bounds.high:g}"


def _type(option: DottedOption) -> str:
    return "CHOICE" if _choices(option) else _TYPES[option.hint]


def _choices(option: DottedOption) -> tuple[str, ...]:
    return get_args(option.hint) if get_origin(option.hint) is Literal else ()
