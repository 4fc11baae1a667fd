"""The runs in a folder, by their reports and session files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.names import PART, SESSION_FILE
from scan3d_twin.run.report import Report
from scan3d_twin.run.report_reader import read_report

REPORT = "report.json"
"""File of the report in a run's folder."""
NO_REPORT = "no report"
"""State of a run without one."""


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
    report: Report
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
    report, state = read_report_or_state(folder / REPORT)
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


def read_report_or_state(path: Path) -> tuple[Report, str]:
    """Return the report in ``path``, and the state of its run; no report if it is not as ours."""
    try:
        return read_report(path), "finished"
    except FileNotFoundError:
        return {}, NO_REPORT
    except FileError:
        return {}, "its report cannot be read"
