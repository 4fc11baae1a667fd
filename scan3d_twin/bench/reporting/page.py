"""The report of an experiment as one self-contained HTML page."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from importlib.resources import files
from itertools import groupby

from scan3d_twin.bench.record import Record
from scan3d_twin.bench.reporting.compare import Comparison, Regret
from scan3d_twin.bench.reporting.figure import TITLES, Cells, Figure
from scan3d_twin.bench.reporting.measures import (
    MEASURES,
    SummaryRow,
    format_estimate,
    format_table,
    rows_as_dicts,
)
from scan3d_twin.bench.reporting.run_list import render_runs
from scan3d_twin.bench.reporting.statistics import Estimate
from scan3d_twin.viz.pages.page import Cell, render_page, render_table

MAX_PICTURES = 12
"""Most top views on the page; the others stay in their folder."""
MAX_PAGE_BYTES = 9_000_000
"""Size that the top views may fill up to: a page of 10 MB still opens at once on a phone."""
RUN_BYTES = 1_000
"""Size of a line in the table of runs, about."""
_DASH = "\N{EN DASH}"
_DOTS = (
    '<p class="note">Each dot leads to the line of its run: click it, or press Tab to reach a '
    "figure, arrows to go from dot to dot, and Enter.</p>"
)


def render_bench_page(
    title: str,
    records: Sequence[Record],
    rows: Sequence[SummaryRow],
    comparisons: Sequence[Comparison],
    regrets: Sequence[Regret],
    figures: Sequence[Figure],
    pictures: Mapping[str, bytes],
) -> str:
    """Return the page.

    Args:
        title: Name of the experiment.
        records: All records.
        rows: Rows of the table of measures.
        comparisons: Comparisons within each scope.
        regrets: Comparisons with the oracle.
        figures: All figures.
        pictures: Top views as SVG, by caption.
    """
    # Put together the sections with a title
    counted = _FigureCount()
    sections = {
        "Results": _render_results(rows),
        "Comparisons": _render_comparisons(comparisons),
        "Against the oracle": _render_regrets(regrets),
        "Top views": _render_pictures(pictures, _picture_room(records, figures), counted),
    }
    for kind, group in groupby(figures, key=lambda figure: figure.kind):
        sections[TITLES[kind]] = _render_figures(list(group), counted)
    sections["Runs"] = _render_runs(records)

    # Number them in an index
    found = [
        (f"section-{k}", name, text) for k, (name, text) in enumerate(sections.items()) if text
    ]
    index = "".join(f'<li><a href="#{place}">{escape(name)}</a></li>' for place, name, _ in found)
    parts = [
        _render_head(title, records),
        f'<nav class="screen" aria-label="Contents"><ul>{index}</ul></nav>',
        *(f'<h2 id="{place}">{escape(name)}</h2>{text}' for place, name, text in found),
    ]
    data = {"runs": len(records), "figures": rows_as_dicts(rows)}
    style, script = _read_asset("report.css"), _read_asset("report.js")
    return render_page(title, parts, data, drawn=False, style=style, script=script)


def comparison_cells(comparisons: Iterable[Comparison]) -> Cells:
    """Return the comparisons as numbers, with a heading."""
    names = [field.name for field in fields(Comparison)]
    rows: Cells = [[*names, "views_low", "views_high", "time_low", "time_high"]]
    for c in comparisons:
        cells = [getattr(c, name) for name in names]
        plain = [cell.value if hasattr(cell, "value") else cell for cell in cells]
        rows.append([*plain, c.views.low, c.views.high, c.time.low, c.time.high])
    return rows


class _FigureCount:
    """Numbers the figures of a page in their order, from 1."""

    def __init__(self) -> None:
        self._last = 0

    def caption(self, text: str) -> str:
        """Return ``text`` after the number of the next figure, as HTML."""
        self._last += 1
        return f"<b>Figure {self._last}.</b> {escape(text)}"


def _render_head(title: str, records: Sequence[Record]) -> str:
    """Return the title and the provenance: runs, seeds, processor hours, versions."""
    # Count runs, seeds and hours
    codes = sorted({record.code for record in records if record.code})
    versions = sorted({record.version for record in records})
    hours = sum(record.cpu or 0.0 for record in records) / 3600
    lost = sum(record.status == "lost" for record in records)
    figures = {
        "Runs": f"{len(records)}",
        "Variants": f"{len({record.variant for record in records})}",
        "Scenes": f"{len({record.scene for record in records})}",
        "Seeds": f"{len({record.seed for record in records})}",
    }
    cells = "".join(f"<div><dt>{name}</dt><dd>{text}</dd></div>" for name, text in figures.items())
    lead = f"{hours:.1f} processor hours; scan3d_twin {', '.join(versions)}"
    lead += f", sources {', '.join(codes)}" if codes else ""

    # Warn of mixed or lost runs
    warnings = []
    if len(codes) > 1:
        warnings.append("These runs are of different sources: do not quote them.")
    if lost:
        warnings.append(f"{lost} runs were lost with their workers and are missing.")
    items = "".join(f"<li>{each}</li>" for each in warnings)
    return (
        f'<header><h1>{escape(title)}</h1><p class="lead">{escape(lead)}.</p>'
        f'<dl class="figures">{cells}</dl></header>'
        + (f'<div class="warnings"><ul>{items}</ul></div>' if items else "")
    )


def _render_results(rows: Sequence[SummaryRow]) -> str:
    names, *lines = format_table(rows)
    terms = "".join(f"<dt>{escape(m.title)}</dt><dd>{escape(m.meaning)}</dd>" for m in MEASURES)
    return (
        f"{_render_texts(names, lines)}"
        '<p class="note">In brackets: 95 % intervals, Wilson\'s for shares of runs and bootstrap '
        "for medians; a single run has none of the latter.</p>"
        f'<details class="terms"><summary>What they mean</summary><dl>{terms}</dl></details>'
    )


def _render_texts(names: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table of texts, intervals below their values."""
    return render_table(names, [[_render_text(text) for text in line] for line in lines])


def _render_text(text: str) -> Cell:
    value, bracket, interval = text.partition(" [")
    below = f"<small>{escape(bracket[1:] + interval)}</small>" if bracket else ""
    return f"<span>{escape(_DASH if value == '-' else value)}{below}</span>", False


def _render_comparisons(comparisons: Sequence[Comparison]) -> str:
    """Return a table per scene and scope."""
    parts = []
    names = ["variant", "pairs", "success", "p of success", "views", "p of views"]
    names += ["time", "p of time"]
    for (scene, scope), group in groupby(comparisons, key=lambda c: (c.scene, c.scope)):
        found = list(group)
        parts.append(f"<h3>{escape(scene)}, registration of the {escape(scope)}: "
                     f"against {escape(found[0].reference)}</h3>")  # fmt: skip
        parts.append(_render_texts(names, map(_compare_cells, found)))
    if parts:
        parts.append(
            '<p class="note">Run by run on the same seeds, within one scope of registration. p: '
            "McNemar's exact test for success, Wilcoxon's signed-rank test for views and time.</p>"
        )
    return "".join(parts)


def _compare_cells(c: Comparison) -> list[str]:
    """Return the cells of a comparison; without pairs there is nothing to compare."""
    if c.pairs == 0:
        return [c.variant, "0", *["-"] * 6]
    return [
        c.variant,
        str(c.pairs),
        f"{100 * c.success:+.0f} points",
        _p_text(c.success_p),
        _ratio(c.views),
        _p_text(c.views_p),
        _ratio(c.time),
        _p_text(c.time_p),
    ]


def _ratio(estimate: Estimate) -> str:
    text = format_estimate(estimate, "{:.2f}")
    return text if estimate.n == 0 else f"\N{MULTIPLICATION SIGN} {text}"


def _p_text(p: float) -> str:
    return f"{p:.2g}" if math.isfinite(p) else "-"


def _render_regrets(regrets: Sequence[Regret]) -> str:
    if not regrets:
        return ""
    names = ["scene", "variant", "oracle", "views over the oracle's", "pairs"]
    lines = [
        [r.scene, r.variant, r.oracle, format_estimate(r.regret, "{:.2f}"), str(r.regret.n)]
        for r in regrets
    ]
    return (
        f"{_render_texts(names, lines)}"
        '<p class="note">Views up to the lower of both final coverages, seed by seed. The oracle '
        "knows the surface and places the fewest views that overlap as required.</p>"
    )


def _picture_room(records: Sequence[Record], figures: Sequence[Figure]) -> float:
    """Return the bytes that the page has left for pictures; as text they take a third more."""
    rest = RUN_BYTES * len(records) + sum(len(figure.svg) for figure in figures)
    return 3 / 4 * (MAX_PAGE_BYTES - rest)


def _render_pictures(pictures: Mapping[str, bytes], room: float, counted: _FigureCount) -> str:
    """Return the first top views, as many as ``room`` [bytes] allows."""
    parts, size = [], 0
    for caption, svg in list(pictures.items())[:MAX_PICTURES]:
        size += len(svg)
        if size > room:
            break
        data = base64.b64encode(svg).decode("ascii")
        parts.append(
            f'<figure><img src="data:image/svg+xml;base64,{data}" '
            f'alt="Top view of {escape(caption, quote=True)}">'
            f"<figcaption>{counted.caption(caption)}</figcaption></figure>"
        )

    # Count the pictures left out
    left = len(pictures) - len(parts)
    more = f'<p class="note">{left} more in top_views/.</p>' if left else ""
    return f'<div class="charts">{"".join(parts)}</div>{more}' if parts or left else ""


def _render_figures(figures: Sequence[Figure], counted: _FigureCount) -> str:
    """Return the figures of one kind."""
    parts = []
    for figure in figures:
        name = escape(figure.file_name, quote=True)
        links = " ".join(
            f'<a href="figures/{name}.{kind}" aria-label="{kind.upper()} of {name}">{kind}</a>'
            for kind in ("svg", "csv")
        )
        parts.append(
            f'<figure class="plot">{figure.svg}<p class="pointed" aria-hidden="true"></p>'
            f"<figcaption>{counted.caption(figure.caption)} {links}</figcaption></figure>"
        )
    linked = any("<a href" in figure.svg for figure in figures)
    return f'{_DOTS if linked else ""}<div class="charts">{"".join(parts)}</div>'


def _render_runs(records: Sequence[Record]) -> str:
    """Return the table of all runs."""
    return (
        "<p>Each seed leads to the folder of its run: its settings and its record, and the "
        "top view if it was drawn. The command, given in the folder of this page, repeats the run "
        f'with all its files.</p><div class="runs">{render_runs(records)}</div>'
    )


def _read_asset(name: str) -> str:
    return (files("scan3d_twin.bench") / name).read_text(encoding="utf-8")
