"""The single runs of a report: the name, the folder and the command of each."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from html import escape

from scan3d_twin.bench.record import Record, replace_nonfinite
from scan3d_twin.bench.reporting.figure import in_file_name
from scan3d_twin.viz.pages.page import Cell, render_table

RUNS_FOLDER = "runs"
"""Folder of the report with one folder a run."""
SETTINGS_FILE, RECORD_FILE, PICTURE_FILE = "settings.toml", "record.json", "top_view.svg"
_DASH = "\N{EN DASH}"


def name_run(record: Record) -> str:
    """Return the name of a run, fit for a folder and unlike that of any other task."""
    name = in_file_name(f"{record.scene}-{record.variant}-{record.seed}")
    return f"{name}-{re.sub(r'[^0-9A-Za-z]', '_', record.key)[:8]}"


def run_anchor(record: Record) -> str:
    """Return the id of the run's line on the page."""
    return f"run-{name_run(record)}"


def run_files(record: Record) -> dict[str, str]:
    """Return the text files of the run's folder by name."""
    row = replace_nonfinite(asdict(record))
    del row["settings"]
    document = json.dumps(row, indent=2, ensure_ascii=False, allow_nan=False)
    return {SETTINGS_FILE: record.settings, RECORD_FILE: document + "\n"}


def run_command(record: Record) -> str:
    """Return the command that repeats the run, given in the report's folder."""
    return f"twin sim --config {RUNS_FOLDER}/{name_run(record)}/{SETTINGS_FILE}"


def render_runs(records: Sequence[Record]) -> str:
    """Return the table of all runs: results, folder and command."""
    names = ["Seed", "Scene", "Variant", "Success", "Views", "Worst error", "Coverage"]
    names += ["Robot's time", "Ended", "Again"]
    ids = map(run_anchor, records)
    return render_table(names, map(_cells, records), remark="Ended", ids=ids)


def _cells(record: Record) -> list[Cell]:
    """Return the cells of one run."""
    folder = escape(f"{RUNS_FOLDER}/{name_run(record)}/", quote=True)
    texts = [
        f'<a href="{folder}">{record.seed}</a>',
        escape(record.scene),
        escape(record.variant),
    ]

    # A lost run has no results
    if record.status == "lost":
        texts += [_DASH] * 5
    else:
        error, time = record.max_error, record.duration
        texts += [
            "yes" if record.success else "no",
            str(record.views),
            _DASH if error is None else f"{1e3 * error:.1f} mm",
            f"{record.coverage:.1%}",
            _DASH if time is None else f"{time:.0f} s",
        ]
    texts += [escape(record.stop), f"<code>{escape(run_command(record))}</code>"]
    worse = record.status != "lost" and not record.success
    return [(text, worse and k == 3) for k, text in enumerate(texts)]
