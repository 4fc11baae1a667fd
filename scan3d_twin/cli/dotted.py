"""Dotted options: one per field of the configuration, named, documented and typed by it."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, fields, is_dataclass, make_dataclass
from typing import Annotated, Any, get_type_hints

from cyclopts import Group, Parameter

from scan3d_twin.run.settings import option_key

GROUP = Group("Configuration in SI units and radians; also from --config FILE")
ENVIRONMENT = "TWIN_"


def dotted_options(*configs: type) -> type:
    """Return a dataclass with an optional field for each ``--section.name`` of ``configs``."""
    sections = list(_sections(configs))
    docs = {name: field_docs(name) for name in {cls.__module__ for _, cls in sections}}
    rows = [
        _option(section, field, hint, docs[cls.__module__][cls.__name__].get(field.name, ""))
        for section, cls in sections
        for hints in [get_type_hints(cls)]
        for field in fields(cls)
        for hint in [hints[field.name]]
    ]
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


def _option(section: str, field: Field[Any], hint: Any, doc: str) -> tuple[str, Any, None]:
    """Return one row for ``make_dataclass``."""
    name = f"{section}.{option_key(field.name)}"
    default = f"{field.default:.6g}" if isinstance(field.default, float) else str(field.default)
    parameter = Parameter(
        name=f"--{name}",
        help=f"{doc} (default {default})",
        env_var=ENVIRONMENT + name.replace(".", "_").upper(),
        group=GROUP,
        show_default=False,
    )
    return f"{section}__{field.name}", Annotated[hint | None, parameter], None
