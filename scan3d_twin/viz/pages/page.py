"""What the pages share: the frame of a document, its data and scripts, and tables that fold."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from itertools import repeat
from typing import Any

OFFLINE_POLICY = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'\">"
)
"""What the page may load: nothing, whatever the names in it hold."""
SCRIPTS = ("report_drawing.js", "report_files.js", "report_e57.js", "report.js")
"""Scripts of a page with a model: they read what the page holds, and stand at its end."""

Cell = tuple[str, bool]
"""HTML of a table's cell, and whether it is worse than wanted."""


def render_page(
    title: str, parts: Iterable[str], data: Any, *, drawn: bool, style: str = "", script: str = ""
) -> str:
    """Return an HTML document that fetches nothing.

    Args:
        title: Title of the window, as text.
        parts: HTML of the sections; empty ones are left out.
        data: What the page gives back as JSON.
        drawn: Whether one of the sections is a model in 3D, which takes scripts.
        style: Style sheet of the page's own, after the common one.
        script: Script of the page's own, at its end.
    """
    sheet = read_asset("report.css") + style
    document = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        OFFLINE_POLICY,
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>{escape(title)}</title><style>{sheet}</style></head><body><main>",
        *parts,
        f'<script type="application/json" id="report">{embed_json(data, indent=2)}</script>',
        *(f"<script>{read_asset(name)}</script>" for name in SCRIPTS if drawn),
        f"<script>{script}</script>" if script else "",
        "</main></body></html>\n",
    ]
    return "\n".join(part for part in document if part)


def embed_json(data: Any, indent: int | None = None) -> str:
    """Return ``data`` as JSON that ends no script element."""
    separators = None if indent else (",", ":")
    text = json.dumps(data, indent=indent, separators=separators, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def render_table(
    names: Sequence[str],
    rows: Iterable[Sequence[Cell]],
    *,
    remark: str = "",
    ids: Iterable[str] | None = None,
) -> str:
    """Return a table; on a narrow screen each cell stands beside its name.

    Args:
        names: Titles of the columns, as text.
        rows: The cells of each row.
        remark: Title of the column of remarks, which is set apart; empty for none.
        ids: The id of each row, to lead to; None for rows without.
    """
    kinds = ["remark" if name == remark else "" for name in names]
    header = "".join(
        f'<th scope="col"{_class_of(kind)}>{escape(name)}</th>'
        for name, kind in zip(names, kinds, strict=True)
    )
    marks = repeat("") if ids is None else (f' id="{escape(each)}"' for each in ids)
    body = "".join(
        _render_row(names, kinds, row, mark) for row, mark in zip(rows, marks, strict=False)
    )
    return (
        '<div class="scroll" tabindex="0" role="group" aria-label="Table"><table>'
        f"<thead><tr>{header}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _render_row(names: Sequence[str], kinds: Sequence[str], row: Sequence[Cell], mark: str) -> str:
    cells = [
        f'<td data-label="{escape(name)}"{_class_of("over" if over else kind)}>{content}</td>'
        for name, kind, (content, over) in zip(names, kinds, row, strict=True)
    ]
    return f"<tr{mark}>{''.join(cells)}</tr>"


def _class_of(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def read_asset(name: str) -> str:
    """Return the text of the file ``name`` of this package: a style sheet or a script."""
    return (files("scan3d_twin.viz") / name).read_text(encoding="utf-8")
