"""The runs in a folder, by their reports and session files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.names import PART, SESSION_FILE


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
        if any((folder / name).is_file() for name in ("report.json", SESSION_FILE, _PARTIAL)):
            yield folder


_PARTIAL = SESSION_FILE + PART


def _describe(folder: Path) -> ListedRun:
    files = [folder / name for name in ("report.json", SESSION_FILE, _PARTIAL)]
    written = max(path.stat().st_mtime for path in files if path.is_file())
    report, state = read_report(folder / "report.json")
    if (folder / _PARTIAL).is_file():
        state = "not finished: twin session recover, or it still runs"
    return ListedRun(folder, written, report, state)


def read_report(path: Path) -> tuple[dict[str, Any], str]:
    """Return the report in ``path``, and the state of its run."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, "no report"
    except (OSError, ValueError):
        return {}, "its report cannot be read"
    return (report, "finished") if isinstance(report, dict) else ({}, "its report cannot be read")
