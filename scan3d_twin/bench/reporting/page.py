"""The report of an experiment as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from importlib.resources import files
from itertools import groupby

from scan3d_twin.bench.record import Record
from scan3d_twin.bench.reporting.compare import Comparison, Regret
from scan3d_twin.bench.reporting.figures import Cells, Figure
from scan3d_twin.bench.reporting.measures import MEASURES, SummaryRow, format_estimate, format_table
from scan3d_twin.viz.page import OFFLINE_POLICY

MAX_PICTURES = 12
"""Most top views on the page, each up to 2 MB; the others stay in their folder."""


def render_page(
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
    parts = [
        f"<h1>{escape(title)}</h1>",
        *_facts(records),
        "<h2>Figures of all runs</h2>",
        _table(format_table(rows)),
        "<p class=facts>In brackets: 95 % intervals, Wilson's for shares of runs and bootstrap for "
        "medians.</p>",
        _meanings(),
        *_comparisons(comparisons),
        *_regrets(regrets),
        *_pictures(pictures),
        *_figures(figures),
    ]
    return "\n".join([_head(title), *parts, "</body></html>\n"])


def _head(title: str) -> str:
    style = (files("scan3d_twin.bench") / "report.css").read_text(encoding="utf-8")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f"{OFFLINE_POLICY}"
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{style}</style></head><body>"
    )


def comparison_cells(comparisons: Iterable[Comparison]) -> Cells:
    """Return the comparisons as numbers, with a heading."""
    names = [field.name for field in fields(Comparison)]
    rows: Cells = [[*names, "views_low", "views_high", "time_low", "time_high"]]
    for c in comparisons:
        cells = [getattr(c, name) for name in names]
        plain = [cell.value if hasattr(cell, "value") else cell for cell in cells]
        rows.append([*plain, c.views.low, c.views.high, c.time.low, c.time.high])
    return rows


def _facts(records: Sequence[Record]) -> list[str]:
    """Return the provenance of the numbers: runs, seeds, processor hours, versions."""
    # Count runs, seeds and hours
    codes = sorted({record.code for record in records if record.code})
    versions = sorted({record.version for record in records})
    hours = sum(record.cpu or 0.0 for record in records) / 3600
    lost = sum(record.status == "lost" for record in records)
    seeds = len({record.seed for record in records})
    parts = [
        f"<p class=facts>{len(records)} runs of {len({r.variant for r in records})} variants "
        f"on {len({r.scene for r in records})} scenes with {seeds} seeds, {hours:.1f} processor "
        f"hours; "
        f"scan3d_twin {', '.join(versions)}, sources {', '.join(codes)}.</p>"
    ]

    # Warn of mixed or lost runs
    if len(codes) > 1:
        parts.append("<p class=note>These runs are of different sources: do not quote them.</p>")
    if lost:
        parts.append(f"<p class=note>{lost} runs were lost with their workers and are missing.</p>")
    return parts


def _table(cells: Sequence[Sequence[str]]) -> str:
    heading, *rows = cells
    head = "".join(f"<th>{escape(cell)}</th>" for cell in heading)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f"<div class=wide>{table}</div>"


def _cell(text: str) -> str:
    """Return a table cell, its interval, if any, below the value."""
    value, bracket, interval = text.partition(" [")
    below = f"<br><small>{escape(bracket[1:] + interval)}</small>" if bracket else ""
    return f"<td>{escape(value)}{below}</td>"


def _meanings() -> str:
    terms = "".join(f"<dt>{escape(m.title)}</dt><dd>{escape(m.meaning)}</dd>" for m in MEASURES)
    return f"<details><summary>What they mean</summary><dl>{terms}</dl></details>"


def _comparisons(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a table per scene and scope."""
    parts = []
    for (scene, scope), group in groupby(comparisons, key=lambda c: (c.scene, c.scope)):
        found = list(group)

        # Fill one row per variant
        heading = ["variant", "pairs", "success", "p", "views", "p", "time", "p"]
        cells = [heading] + [
            [
                c.variant,
                str(c.pairs),
                f"{100 * c.success:+.0f} points",
                f"{c.success_p:.2g}",
                "\N{MULTIPLICATION SIGN} " + format_estimate(c.views, "{:.2f}"),
                f"{c.views_p:.2g}",
                "\N{MULTIPLICATION SIGN} " + format_estimate(c.time, "{:.2f}"),
                f"{c.time_p:.2g}",
            ]
            for c in found
        ]

        # Title and table
        parts.append(f"<h2>{escape(scene)}, registration of the {escape(scope)}: "
                     f"against {escape(found[0].reference)}</h2>")  # fmt: skip
        parts.append(_table(cells))
    if parts:
        parts.append(
            "<p class=facts>Run by run on the same seeds, within one scope of registration. p: "
            "McNemar's exact test for success, Wilcoxon's signed-rank test for views and time.</p>"
        )
    return parts


def _regrets(regrets: Sequence[Regret]) -> list[str]:
    if not regrets:
        return []
    cells = [["scene", "variant", "oracle", "views over the oracle's", "pairs"]] + [
        [r.scene, r.variant, r.oracle, format_estimate(r.regret, "{:.2f}"), str(r.regret.n)]
        for r in regrets
    ]
    return [
        "<h2>Against the oracle</h2>",
        _table(cells),
        "<p class=facts>Views up to the lower of both final coverages, seed by seed. The oracle "
        "knows the surface and places the fewest views that overlap as required.</p>",
    ]


def _pictures(pictures: Mapping[str, bytes]) -> list[str]:
    if not pictures:
        return []

    # Embed pictures with their captions
    shown = list(pictures.items())[:MAX_PICTURES]
    parts = ["<h2>F1: top views</h2><div class=figures>"]
    for caption, svg in shown:
        data = base64.b64encode(svg).decode("ascii")
        parts.append(
            f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(caption)}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )

    # Count the pictures left out
    left = len(pictures) - len(shown)
    parts.append("</div>" + (f"<p class=facts>{left} more in top_views/.</p>" if left else ""))
    return parts


def _figures(figures: Sequence[Figure]) -> list[str]:
    parts = []
    for number, group in groupby(sorted(figures, key=_number), key=_number):
        parts.append(f"<h2>{number}: {_TITLES[number]}</h2><div class=figures>")
        for figure in group:
            links = "".join(
                f' <a href="figures/{escape(figure.name)}.{kind}">{kind}</a>'
                for kind in ("svg", "csv")
            )
            parts.append(
                f"<figure>{figure.svg}<figcaption>{escape(figure.caption)}{links}</figcaption>"
                "</figure>"
            )
        parts.append("</div>")
    return parts


_TITLES = {
    "F2": "views and errors",
    "F3": "coverage",
    "F4": "predicted and realised errors",
    "F5": "overlaps and features",
    "F6": "the error the planner assumes",
    "F7": "variants side by side",
}


def _number(figure: Figure) -> str:
    return figure.name[:2]
