"""Dotted options: one per field of the configuration, named, documented and typed by it."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from cyclopts import Group, Parameter

from scan3d_twin.cli.defaults import PREFIX
from scan3d_twin.core.options import Bounds, option_key

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions


@dataclass(frozen=True, slots=True)
class DottedOption:
    """A field of the configuration as an option of the command line.

    Attributes:
        section: Name of its section.
        name: Name of the field.
        hint: Its type.
        bounds: The values that it may have, if it is a number.
        doc: What it means, in one line.
    """

    section: str
    name: str
    hint: Any
    bounds: Bounds | None
    doc: str

    @property
    def key(self) -> str:
        """Its key in a configuration file, such as ``planning.eta_min``."""
        return f"{self.section}.{option_key(self.name)}"

    @property
    def flag(self) -> str:
        """Its name on the command line, such as ``--planning.eta-min``."""
        return "--" + self.key.replace("_", "-")

    @property
    def variable(self) -> str:
        """Its name in the environment, such as ``TWIN_PLANNING_ETA_MIN``."""
        return PREFIX + self.key.replace(".", "_").upper()


def dotted_fields(*configs: type) -> Iterator[DottedOption]:
    """Yield an option for each field of each section of ``configs``."""
    docs: dict[str, dict[str, dict[str, str]]] = {}
    for section, cls in _sections(configs):
        if cls.__module__ not in docs:
            docs[cls.__module__] = field_docs(cls.__module__)
        known, hints = docs[cls.__module__][cls.__name__], get_type_hints(cls)
        for field in fields(cls):
            bounds, doc = field.metadata.get("bounds"), known.get(field.name, "")
            yield DottedOption(section, field.name, hints[field.name], bounds, doc)


def dotted_options(*configs: type) -> type:
    """Return a dataclass with an optional field for each ``--section.name`` of ``configs``."""
    rows = [_row(option) for option in dotted_fields(*configs)]
    names = {"__module__": __name__, "__doc__": "Dotted options; None is not stated."}
    return make_dataclass("DottedOptions", rows, frozen=True, kw_only=True, namespace=names)


def stated(options: Any) -> Mapping[str, Mapping[str, Any]]:
    """Return the dotted ``options`` that were given, as sections of a configuration."""
    sections: dict[str, dict[str, Any]] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if value is not None:
            section, _, name = field.name.partition("__")
            sections.setdefault(section, {})[option_key(name)] = value
    return sections


def field_docs(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings below the fields of a module's classes, each as one line.

    By class and field.
    """
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: _docs(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _docs(tree: ast.ClassDef) -> dict[str, str]:
    docs, name = {}, ""
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and name:
            docs[name] = " ".join(str(node.value.value).split())
            name = ""
    return docs


def _sections(configs: Iterable[type]) -> Iterator[tuple[str, type]]:
    for cls in configs:
        for name, hint in get_type_hints(cls).items():
            if is_dataclass(hint):
                assert isinstance(hint, type)
                yield name, hint


def _row(option: DottedOption) -> tuple[str, Any, None]:
    """Return ``option`` as a row for ``make_dataclass``."""
    parameter = Parameter(
        name=option.flag, help=option.doc, env_var=option.variable, group=GROUP, show_default=False
    )
    return f"{option.section}__{option.name}", Annotated[option.hint | None, parameter], None


def _point_to_list(console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
    """Print where the options of ``panel`` are listed, in place of the panel itself."""
    count = len(panel.entries)
    console.print(
        f"\n{count} more options, such as --planning.trials: twin options [SECTION]",
        markup=False,
        highlight=False,
    )


GROUP = Group("Configuration", help_formatter=_point_to_list)
"""Kept together for help pages, where they would fill five screens."""
