"""The report in a few lines for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scan3d_twin.run.report import Report

SHARE, LENGTH = "{:.0%}", "{:.1f} mm"
"""How tables show an overlap and an error [mm]."""
_COLUMNS = (
    ("view", "view", "{}"),
    ("overlap", "overlap", SHARE),
    ("predicted_rmse_mm", "predicted", LENGTH),
    ("error_mm", "realised", LENGTH),
    ("odometry_error_mm", "odometry", LENGTH),
)
_MIN_WIDTH = 9
"""Smallest width of a column."""


def summary(report: Report, folder: Path) -> str:
    """Return the headline numbers, a table of the registrations and the names of the files."""
    lines = [
        f"{report['scene']}: {count(report['views'], 'view')}, {report['points']} points; "
        f"{report['stop_reason']}",
        f"{report['sim_time_s']:.0f} s on the robot's clock, {report['path_m']:.1f} m driven, "
        f"{report['wall_time_s']:.0f} s computed",
    ]
    if report["coverage_20mm"] is not None:
        lines.append(
            f"surface: {report['coverage_20mm']:.1%} of what the lidar can reach is covered "
            f"(within 20 mm); accuracy {report['accuracy_mm']['median']:.1f} mm (median)"
        )
    lines += ["", *_table(report), ""] if report["registration"] else []
    files = "model.ply report.html report.json top_view.svg config.toml session.mcap views/"
    lines.append(f"{folder}: {files}")
    return "\n".join(lines) + "\n"


def next_steps(folder: Path) -> str:
    """Return three commands that a finished run in ``folder`` leads to, and what each does."""
    steps = {
        f"twin view {folder}": "look at it in a browser",
        f"twin mesh {folder}": "make a surface of it, to print or to measure",
        "twin sim --scene YOUR.stl": "digitise a thing of your own (docs/tutorial.md)",
    }
    width = max(map(len, steps))
    return "\n".join(["next:", *(f"  {step:<{width}}  {what}" for step, what in steps.items())])


def count(number: int, noun: str) -> str:
    """Return ``number`` things: ``1 view``, ``2 views``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def format_cell(value: float | None, form: str) -> str:
    """Return ``value`` as ``form`` shows it; a dash where there is none."""
    return "-" if value is None else form.format(value)


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return ``header`` and ``rows`` as lines, aligned on the right.

    A row may be longer than the header: what it has more is a remark, and not aligned.
    """
    widths = [max(_MIN_WIDTH, len(title)) for title in header]
    lines = []
    for row in (header, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=False)]
        lines.append("  ".join([*cells, *row[len(widths) :]]))
    return lines


def _table(report: Report) -> list[str]:
    rows = []
    for row in report["registration"]:
        cells = [format_cell(row[key], form) for key, _, form in _COLUMNS]
        marks = [] if row["converged"] else ["not registered"]
        rows.append(cells + marks + (["above epsilon"] if row["fell_back"] else []))
    return format_table([title for _, title, _ in _COLUMNS], rows)
