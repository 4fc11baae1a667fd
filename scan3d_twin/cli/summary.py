"""The report in a few lines for people."""

from __future__ import annotations

from pathlib import Path

from scan3d_twin.run.report import Report

_COLUMNS = (
    ("view", "view", "{}"),
    ("overlap", "overlap", "{:.0%}"),
    ("predicted_rmse_mm", "predicted", "{:.1f} mm"),
    ("error_mm", "realised", "{:.1f} mm"),
    ("odometry_error_mm", "odometry", "{:.1f} mm"),
)


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


def count(number: int, noun: str) -> str:
    """Return ``number`` things: ``1 view``, ``2 views``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _table(report: Report) -> list[str]:
    rows = [[title for _, title, _ in _COLUMNS]]
    for row in report["registration"]:
        cells = ["-" if row[k] is None else form.format(row[k]) for k, _, form in _COLUMNS]
        marks = [] if row["converged"] else ["not registered"]
        rows.append(cells + marks + (["fell back to 80 %"] if row["fell_back"] else []))
    return ["  ".join(f"{cell:>9}" for cell in row) for row in rows]
