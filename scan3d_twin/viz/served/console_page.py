"""The page of ``twin console``: its frame and forms; what changes is filled in by its script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from scan3d_twin.viz.branding import ICON
from scan3d_twin.viz.pages.page import embed_json, read_asset
from scan3d_twin.viz.served.banner import COLOURS

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the page may load: its own style sheet, script and data."""
FILE_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; "
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""What a page in a run's folder may do, which may come from someone else: it has an origin of its
own, so that it reads and presses nothing here."""
_TITLES = {"sim": "Simulated robot", "real": "Real robot"}
_STARTS = {"sim": "Start the simulation", "real": "Start: the robot will drive"}


@dataclass(frozen=True)
class FormField:
    """An option of a run as a field of a form.

    Attributes:
        name: Name of the option.
        flag: The same on the command line.
        help: What it means, in one line.
        default: What holds where nothing is entered; empty for nothing.
        choices: The only values that it may have; empty for any.
        suggestions: Values that are known, and others possible.
        is_number: Whether it is a number.
    """

    name: str
    flag: str
    help: str
    default: str
    choices: tuple[str, ...]
    suggestions: tuple[str, ...]
    is_number: bool


def render_console_page(
    forms: Mapping[str, tuple[Sequence[FormField], Sequence[FormField]]],
    ports: Sequence[str],
    formats: Sequence[str],
    columns: Sequence[str],
    lead: str,
) -> str:
    """Return the page as one HTML document, which loads ``console.css`` and ``console.js``.

    Args:
        forms: Fields of each kind of run, those shown at once and those that fold.
        ports: Serial ports on USB, as text.
        formats: Names of the formats of an export.
        columns: Titles of the figures of a run.
        lead: What stands below the title.
    """
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<link rel="icon" href="data:image/svg+xml,{quote(ICON)}">',
        '<link rel="stylesheet" href="console.css">',
        "<title>Console - scan3d_twin</title></head><body><main>",
        f'<header><h1>Robot console</h1><p class="lead">{escape(lead)}</p></header>',
        _NOW,
        _render_forms(forms),
        _render_robot(ports),
        _render_runs(formats),
        '<div id="refusal" role="alert" hidden><p></p><button>Close</button></div>',
        f'<script type="application/json" id="columns">{embed_json(list(columns))}</script>',
        '<script src="console.js"></script></main></body></html>\n',
    ]
    return "\n".join(parts)


def render_console_style() -> str:
    """Return the style sheet of the page: that of the other pages, and its own."""
    states = "".join(f".badge.{state} {{ background: {c}; }}\n" for state, c in COLOURS.items())
    return read_asset("report.css") + read_asset("console.css") + states


_NOW = """<section aria-labelledby="now"><h2 id="now">Now</h2><div class="card">
<p><span id="state" class="badge waiting" role="status">no run yet</span>
<code id="command"></code></p>
<p id="last" class="note">Start a run below.</p>
<p id="error" class="warnings" hidden></p>
<div class="bar"><a id="watch" class="button" target="_blank" rel="noopener noreferrer" hidden>Open
the live view</a><button id="pause" disabled>Pause</button><button id="continue" hidden>Continue
</button><button id="stop" class="danger" disabled>Stop</button></div>
<details id="progress" hidden><summary>What the run says</summary>
<pre id="lines" tabindex="0" aria-label="Lines of the run"></pre></details>
</div></section>"""


def _render_forms(
    forms: Mapping[str, tuple[Sequence[FormField], Sequence[FormField]]],
) -> str:
    """Return the choice of the kind of run, and a form for each."""
    first = next(iter(forms))
    chosen = "".join(
        f'<label><input type="radio" name="kind" value="{kind}"'
        f"{' checked' if kind == first else ''}> {_TITLES[kind]}</label>"
        for kind in forms
    )
    return (
        '<section aria-labelledby="new"><h2 id="new">New run</h2>'
        f'<fieldset class="kinds"><legend>Robot</legend>{chosen}</fieldset>'
        + "".join(_render_form(kind, *fields, kind != first) for kind, fields in forms.items())
        + "</section>"
    )


def _render_form(
    kind: str, shown: Sequence[FormField], folded: Sequence[FormField], hidden: bool
) -> str:
    more = (
        f'<div class="field wide"><label for="{kind}-more">Other options</label>'
        f'<input name="more" id="{kind}-more" placeholder="none" autocomplete="off" '
        f'spellcheck="false" aria-describedby="{kind}-more-help"><small id="{kind}-more-help">As '
        "on the command line, such as <code>--planning.trials 5</code>; <code>twin options</code> "
        "lists them.</small></div>"
    )
    return (
        f'<form id="{kind}" class="card"{" hidden" if hidden else ""}>'
        f'<p class="note">An empty field takes the value shown in grey.</p>'
        f'<div class="fields">{"".join(_render_field(kind, each) for each in shown)}</div>'
        f'<details><summary>More options</summary><div class="fields">'
        f"{''.join(_render_field(kind, each) for each in folded)}{more}</div></details>"
        f'<div class="bar"><button class="primary">{_STARTS[kind]}</button></div></form>'
    )


def _render_field(kind: str, field: FormField) -> str:
    """Return a field with its name, its default in grey and its help."""
    own = f"{kind}-{field.name}"
    common = f'id="{own}" name="{field.name}" aria-describedby="{own}-help"'
    title = escape(field.flag.removeprefix("--").replace("-", " ").capitalize())
    default = escape(field.default)
    if field.choices:
        options = [("", f"default: {default}"), *((each, escape(each)) for each in field.choices)]
        listed = "".join(f'<option value="{escape(v)}">{text}</option>' for v, text in options)
        control = f"<select {common}>{listed}</select>"
    else:
        mode = ' inputmode="decimal"' if field.is_number else ""
        known = f' list="{own}-list"' if field.suggestions else ""
        control = (
            f'<input {common}{mode}{known} placeholder="{default}" autocomplete="off" '
            'spellcheck="false">'
        )
        if field.suggestions:
            values = "".join(f'<option value="{escape(each)}">' for each in field.suggestions)
            control += f'<datalist id="{own}-list">{values}</datalist>'
    return (
        f'<div class="field"><label for="{own}" title="{escape(field.flag)}">{title}</label>'
        f'{control}<small id="{own}-help">{escape(field.help)}</small></div>'
    )


def _render_robot(ports: Sequence[str]) -> str:
    listed = "".join(f"<li><code>{escape(each)}</code></li>" for each in ports)
    found = f"<ul>{listed}</ul>" if listed else "<p>No serial port on USB.</p>"
    return (
        '<section aria-labelledby="robot"><h2 id="robot">Ports and devices</h2><div class="card">'
        f'<div id="ports">{found}</div><div class="bar"><button id="check">Check the robot</button>'
        '</div><p class="note">Takes the ports and devices entered for the real robot; looks at '
        "permissions and libraries too. Nothing moves.</p>"
        '<div id="findings" aria-live="polite"></div></div></section>'
    )


def _render_runs(formats: Sequence[str]) -> str:
    options = "".join(f"<option>{escape(each)}</option>" for each in formats)
    return (
        '<section aria-labelledby="earlier"><h2 id="earlier">Earlier runs</h2>'
        '<div class="bar"><button id="compare" disabled>Compare the marked runs</button>'
        f'<label>Export as <select id="format">{options}</select></label>'
        '<a id="comparison" class="button" href="compare.html" target="_blank" '
        'rel="noopener noreferrer" hidden>Open the comparison</a>'
        '<span id="work" class="note" role="status"></span></div>'
        '<div id="runs"><p class="note">None yet.</p></div></section>'
    )
