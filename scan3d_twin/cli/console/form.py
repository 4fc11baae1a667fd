"""The options of a run as a form, and a filled form as a command line.

Names, defaults, choices and help are those of the option classes, so that the page and
``twin sim --help`` cannot differ.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from cyclopts import Parameter

from scan3d_twin.cli.commands.real import RealOptions
from scan3d_twin.cli.commands.sim import SimOptions
from scan3d_twin.cli.dotted import field_docs
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.viz.served.console_page import FormField

Kind = Literal["sim", "real"]
KINDS: tuple[Kind, ...] = ("sim", "real")
"""The commands that start a run."""
_CLASSES: dict[Kind, type] = {"sim": SimOptions, "real": RealOptions}
COMMON: dict[Kind, tuple[str, ...]] = {
    "sim": (
        "scene", "epsilon", "tour", "target", "preset", "planner", "max_views", "seed", "world",
        "robot", "lidar",
    ),
    "real": (
        "port", "lidar_port", "robot", "lidar", "epsilon", "tour", "target", "preset", "planner",
        "max_views",
    ),
}  # fmt: skip
"""The options that the form shows at once; the others fold."""
OWN = (
    "out", "json", "view", "host", "view_port", "commands", "resume", "targets", "dry_run",
)  # fmt: skip
"""Options that the console states itself, or has another place for."""
_NO_OPTIONS = ("help", "h", "version", "install_completion")
"""Flags that would start no run."""
MAX_LENGTH = 400
"""Longest value of an option [characters]: more than a path needs."""


@cache
def form_fields(kind: Kind) -> tuple[FormField, ...]:
    """Return the options of the command ``kind``, the common ones first."""
    common = COMMON[kind]
    found = {field.name: field for field in _fields(_CLASSES[kind])}
    return (*(found.pop(name) for name in common), *found.values())


def build_command(
    kind: str, values: Mapping[str, Any], more: str, own: Sequence[str]
) -> tuple[str, ...]:
    """Return the arguments of ``twin`` for a filled form; the command checks the values itself.

    Args:
        kind: ``sim`` or ``real``.
        values: Values by name of the option, as typed; empty ones are not stated.
        more: Further options as on a command line, such as ``--planning.trials 5``.
        own: What the console states itself.

    Raises:
        ConfigError: There is no such command or option, or it is not for the user to state here.
    """
    if kind not in KINDS:
        raise ConfigError(f"no run of the kind {kind!r}; known: {', '.join(KINDS)}")
    flags = {field.name: field.flag for field in form_fields(kind)}
    stated = []
    for name, value in values.items():
        if name not in flags:
            raise ConfigError(f"no option {name!r} in this form")
        if text := _checked(flags[name], value):
            stated.append(f"{flags[name]}={text}")
    return (kind, *stated, *_split(_checked("more options", more)), *own)


def chosen_scene(values: Mapping[str, Any]) -> str:
    """Return the name of the scene that a filled form of the twin means."""
    return str(values.get("scene") or _default_of("TWIN_SCENE", SimOptions, "scene"))


def _checked(what: str, value: Any) -> str:
    """Return ``value`` without blanks around it, if it can be an argument."""
    if not isinstance(value, str):
        raise ConfigError(f"{what}: not a text")
    text = value.strip()
    if len(text) > MAX_LENGTH or not text.isprintable():
        raise ConfigError(f"{what}: more than {MAX_LENGTH} characters, or one that is not printed")
    return text


def _split(more: str) -> list[str]:
    """Return the arguments in ``more``; none that the console states itself."""
    try:
        arguments = shlex.split(more)
    except ValueError as error:
        raise ConfigError(f"more options: {str(error).lower()}") from None
    for each in arguments:
        name = each.partition("=")[0].lstrip("-").replace("-", "_")
        if each.startswith("-") and name in (*OWN, *_NO_OPTIONS):
            raise ConfigError(f"more options: {each.partition('=')[0]} is not for this page")
    return arguments


def _fields(cls: type) -> Iterator[FormField]:
    """Yield the options of ``cls`` and the classes it inherits, as fields of a form."""
    docs = {
        name: doc
        for base in reversed(cls.__mro__[:-1])
        for name, doc in field_docs(base.__module__)[base.__name__].items()
    }
    for name, hint in get_type_hints(cls, include_extras=True).items():
        if name in OWN:
            continue
        kind, *parameters = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
        if any(each.show is False for each in parameters):
            continue
        variable, default = _variable(parameters), _default(parameters)
        if variable in os.environ:
            default = f"{os.environ[variable]} ({variable})"
        yield FormField(
            name=name,
            flag="--" + name.replace("_", "-"),
            help=docs[name].replace("`", ""),
            default=default,
            choices=_choices(kind),
            suggestions=_SUGGESTIONS.get(name, tuple)(),
            is_number=bool({int, float} & set(get_args(kind))),
        )


def _default_of(variable: str, cls: type, name: str) -> str:
    hint = get_type_hints(cls, include_extras=True)[name]
    return os.environ.get(variable) or _default(get_args(hint)[1:])


def _variable(parameters: Sequence[Parameter]) -> str:
    return next((each for one in parameters for each in one.env_var or ()), "")


def _default(parameters: Sequence[Parameter]) -> str:
    """Return the default that the help page shows."""
    for each in parameters:
        if callable(each.show_default):
            return str(each.show_default(None))
    return ""


def _choices(hint: Any) -> tuple[str, ...]:
    """Return the values that ``hint`` names, none where it is not a choice."""
    if bool in (hint, *get_args(hint)):
        return ("true",)
    kinds = [each for each in get_args(hint) if each is not NoneType]
    if kinds and get_origin(kinds[0]) is Literal:
        return tuple(map(str, get_args(kinds[0])))
    return ()


def _scenes() -> tuple[str, ...]:
    from scan3d_twin.sim.scenes.load import scene_names

    return tuple(scene_names())


def _planners() -> tuple[str, ...]:
    from scan3d_twin.core.planning import list_planners

    return tuple(list_planners())


def _bases() -> tuple[str, ...]:
    from scan3d_twin.devices.registry import base_names

    return tuple(base_names())


def _lidars() -> tuple[str, ...]:
    from scan3d_twin.devices.registry import lidar_names

    return tuple(lidar_names())


def _presets() -> tuple[str, ...]:
    from scan3d_twin.core.presets import PRESETS

    return tuple(PRESETS)


def _worlds() -> tuple[str, ...]:
    from scan3d_twin.sim.config import WORLDS

    return tuple(WORLDS)


_SUGGESTIONS: dict[str, Callable[[], tuple[str, ...]]] = {
    "scene": _scenes, "planner": _planners, "robot": _bases, "lidar": _lidars,
    "preset": _presets, "world": _worlds,
}  # fmt: skip
"""Known values of the options that take names, and others besides."""

PROGRAM = (sys.executable, "-m", "scan3d_twin.cli")
"""The program ``twin``, as this console runs it."""
