"""``twin runs``: the earlier runs."""

from __future__ import annotations

import json as json_module
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scan3d_twin.cli.output import say
from scan3d_twin.run.folder import RUNS

if TYPE_CHECKING:
    from scan3d_twin.recording.overview.listing import ListedRun

COLUMNS = (
    ("views", "views", "{:.0f}"),
    ("worst", "max_registration_error_mm", "{:.1f} mm"),
    ("covered", "coverage_20mm", "{:.0%}"),
    ("time", "sim_time_s", "{:.0f} s"),
)
"""Columns of the list: title, key of the report, and form."""


def runs(folder: Path = RUNS, /, *, json: bool = False) -> None:
    """List the runs in a folder, the latest first.

    With the number of views, the worst registration error and the share of the surface that is
    covered, both known in the twin only, and the time on the robot's clock.

    Args:
        folder: Where the runs are.
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.cli.summary import format_table
    from scan3d_twin.recording.overview.listing import list_runs

    found = list_runs(folder)
    if json:
        print(json_module.dumps([_plain(run) for run in found], indent=2))
        return
    if not found:
        say(f"no runs in {folder}", sys.stdout)
        return
    rows = [
        [*(format_number(run, key, form) for _, key, form in COLUMNS), _words(run)] for run in found
    ]
    say("\n".join(format_table([title for title, _, _ in COLUMNS], rows)), sys.stdout)


def format_number(run: ListedRun, key: str, form: str) -> str:
    """Return the number ``key`` of the report of ``run``; a dash where it is not known."""
    value: Any = run.report.get(key)
    return form.format(value) if isinstance(value, int | float) else "-"


def _words(run: ListedRun) -> str:
    """Return the folder of ``run``, and what is to be said of it."""
    notes = list_notes(run)
    return f" {run.folder}" + (f" ({'; '.join(notes)})" if notes else "")


def list_notes(run: ListedRun) -> list[str]:
    """Return what is to be said of ``run``: that it is not finished, and its warnings."""
    notes = [] if run.state == "finished" else [run.state]
    warnings = run.report.get("warnings")
    if isinstance(warnings, list) and warnings:
        notes.append("1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings")
    return notes


def _plain(run: ListedRun) -> dict[str, Any]:
    written = datetime.fromtimestamp(run.written, UTC).isoformat(timespec="seconds")
    keys = ("scene", "seed", *(key for _, key, _ in COLUMNS), "stop_reason", "warnings")
    chosen = {key: run.report.get(key) for key in keys}
    return {"folder": str(run.folder), "written": written, "state": run.state, **chosen}
