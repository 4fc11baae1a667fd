"""The runs in a folder, by their reports and session files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.names import PART, SESSION_FILE

REPORT = "report.json"
"""File of the report in a run's folder."""
NO_REPORT = "no report"
"""State of a run without one."""
_NUMBERS = ("views", "seed", "coverage_20mm", "max_registration_error_mm", "path_m", "sim_time_s")
"""Fields of a report that are numbers, or not known."""


@dataclass(frozen=True)
class ListedRun:
    """A run as a list shows it.

    Attributes:
        folder: Its folder.
        written: When its last file was written [s since 1970].
        report: Its ``report.json``; empty where there is none, or none that can be read.
        state: ``finished``, or what is wrong with it in words.
    """

    folder: Path
    written: float
    report: dict[str, Any]
    state: str


def list_runs(place: Path) -> list[ListedRun]:
    """Return the runs in the folder ``place`` and the folders in it, the latest first.

    Raises:
        FileError: There is no such folder.
    """
    if not place.is_dir():
        raise FileError(f"no folder {place}: runs are in runs/, or where --out put them")
    runs = [_describe(folder) for folder in _folders(place)]
    return sorted(runs, key=lambda run: (-run.written, str(run.folder)))


def _folders(place: Path) -> Iterator[Path]:
    """Yield ``place`` and the folders in it and below, that hold a run."""
    for folder in [place, *sorted(place.glob("*/")), *sorted(place.glob("*/target-*/"))]:
        if any((folder / name).is_file() for name in (REPORT, SESSION_FILE, _PARTIAL)):
            yield folder


_PARTIAL = SESSION_FILE + PART


def _describe(folder: Path) -> ListedRun:
    written = max(_time_written(folder / name) for name in (REPORT, SESSION_FILE, _PARTIAL))
    report, state = read_report(folder / REPORT)
    if (folder / _PARTIAL).is_file():
        state = "not finished: twin session recover, or it still runs"
    elif not report and state == NO_REPORT:
        state = f"{NO_REPORT}: ended while it was saved? twin sim --resume writes it"
    return ListedRun(folder, written, report, state)


def _time_written(path: Path) -> float:
    """Return when the file ``path`` was written [s since 1970]; 0 if a run has just renamed it."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def read_report(path: Path) -> tuple[dict[str, Any], str]:
    """Return the report in ``path``, and the state of its run; no report if it is not as ours."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, NO_REPORT
    except (OSError, ValueError, RecursionError):
        return {}, "its report cannot be read"
    return (report, "finished") if _is_report(report) else ({}, "its report cannot be read")


def _is_report(report: Any) -> bool:
    """Return whether ``report`` has the types that are read here, where it has the fields."""
    if not isinstance(report, dict):
        return False
    numbers = all(_is_number(report.get(key)) for key in _NUMBERS)
    steps = report.get("registration", [])
    rows = isinstance(steps, list) and all(
        isinstance(row, dict)
        and isinstance(row.get("view"), int)
        and _is_number(row.get("error_mm"))
        for row in steps
    )
    shares, accuracy = report.get("coverage_by_view"), report.get("accuracy_mm")
    listed = shares is None or (isinstance(shares, list) and all(map(_is_number, shares)))
    known = accuracy is None or (
        isinstance(accuracy, dict) and all(map(_is_number, accuracy.values()))
    )
    return numbers and rows and listed and known


def _is_number(value: Any) -> bool:
    """Return whether ``value`` is a number or not known."""
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
