"""The variables ``TWIN_*``: each option that can be saved may also be set in the environment."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from scan3d_twin import limits
from scan3d_twin.cli.defaults import PREFIX
from scan3d_twin.core.errors import ConfigError, find_near_name

if TYPE_CHECKING:
    from cyclopts import ArgumentCollection

SYNONYMS = (("--robot", "--base"), ("--epsilon", "--planning.epsilon"))
"""Options that are the same."""


def prefer_command_line(_: Any, command: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Forget what the environment says of an option that is given under its other name.

    A hook that cyclopts calls before each command.
    """
    for names in SYNONYMS:
        same = [each for each in arguments if each.name in names]
        if any(token.source == "cli" for each in same for token in each.tokens):
            for each in same:
                each.tokens[:] = [token for token in each.tokens if token.source == "cli"]


def refuse_unknown_variables(*_: Any) -> None:
    """Refuse a variable TWIN_* that sets no option of any command.

    A hook that cyclopts calls before each command, with arguments that are of no use here.

    Raises:
        ConfigError: There is one; the message names the option that was probably meant.
    """
    present = sorted(name for name in os.environ if name.startswith(PREFIX))
    if not present:
        return
    known = {*known_variables(), limits.VARIABLE}
    for name in present:
        if name not in known:
            raise ConfigError(f"the variable {name} sets no option; {_suggest_cure(name, known)}")


def _suggest_cure(name: str, known: Iterable[str]) -> str:
    """Return what to do about the unknown variable ``name``; the common prefix makes none near."""
    own = (each.removeprefix(PREFIX) for each in known)
    near = find_near_name(name.removeprefix(PREFIX), own)
    return "unset it, or see `twin options`" if near is None else f"did you mean {PREFIX}{near}?"


def known_variables() -> frozenset[str]:
    """Return the variables that set an option of some command."""
    from scan3d_twin.cli.dotted import dotted_fields
    from scan3d_twin.cli.options import PortOptions, RunOptions, SceneOptions, TurntableOptions
    from scan3d_twin.cli.viewing import ViewOptions
    from scan3d_twin.core.config import Config
    from scan3d_twin.sim.config import TwinConfig

    dotted = (option.variable for option in dotted_fields(Config, TwinConfig))
    described = (SceneOptions, TurntableOptions, RunOptions, PortOptions, ViewOptions)
    return frozenset([*dotted, *_variables(described)])


def _variables(classes: Iterable[type]) -> Iterator[str]:
    """Yield the variables that the annotated fields of option ``classes`` name."""
    from cyclopts import Parameter

    for cls in classes:
        for hint in get_type_hints(cls, include_extras=True).values():
            for each in get_args(hint)[1:]:
                if isinstance(each, Parameter):
                    yield from each.env_var or ()
