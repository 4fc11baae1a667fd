"""What the pages share: the frame of a document, its data and scripts, and tables that fold."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

OFFLINE_POLICY = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'\">"
)
"""What the page may load: nothing, whatever the names in it hold."""
SCRIPTS = ("report_drawing.js", "report_files.js", "report.js")
"""Scripts of a page with a model: they read what the page holds, and stand at its end."""

Cell = tuple[str, bool]
"""HTML of a table's cell, and whether it is worse than wanted."""


def render_page(title: str, parts: Iterable[str], data: Any, *, drawn: bool) -> str:
    """Return an HTML document that fetches nothing.

    Args:
        title: Title of the window, as text.
        parts: HTML of the sections; empty ones are left out.
        data: What the page gives back as JSON.
        drawn: Whether one of the sections is a model in 3D, which takes scripts.
    """
    document = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        OFFLINE_POLICY,
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{_read_asset('report.css')}</style></head><body><main>",
        *parts,
        f'<script type="application/json" id="report">{embed_json(data, indent=2)}</script>',
        *(f"<script>{_read_asset(name)}</script>" for name in SCRIPTS if drawn),
        "</main></body></html>\n",
    ]
    return "\n".join(part for part in document if part)


def embed_json(data: Any, indent: int | None = None) -> str:
    """Return ``data`` as JSON that ends no script element."""
    separators = None if indent else (",", ":")
    text = json.dumps(data, indent=indent, separators=separators, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def render_table(names: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """Return a table; on a narrow screen each cell stands beside its name.

    Args:
        names: Titles of the columns, as text.
        rows: The cells of each row.
    """
    header = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(_render_row(names, row) for row in rows)
    return (
        '<div class="scroll"><table>'
        f"<thead><tr>{header}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _render_row(names: Sequence[str], row: Sequence[Cell]) -> str:
    kinds = {True: ' class="over"', False: ""}
    cells = [
        f'<td data-label="{escape(name)}"{kinds[over]}>{content}</td>'
        for name, (content, over) in zip(names, row, strict=True)
    ]
    return f"<tr>{''.join(cells)}</tr>"


def _read_asset(name: str) -> str:
    return (files("scan3d_twin.viz") / name).read_text(encoding="utf-8")
