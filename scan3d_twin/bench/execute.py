"""Runs the open tasks of an experiment and writes each record to the journal."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from scan3d_twin.bench.engine import Engine, run_on_workers
from scan3d_twin.bench.journal import JOURNAL_PATTERN, Journal, read_journals
from scan3d_twin.bench.record import Record
from scan3d_twin.bench.task import Task
from scan3d_twin.run.folder import write_inside

PICTURES_FOLDER = "top_views"
"""Folder with the top view of each variant's first seed."""


def find_open_tasks(tasks: Sequence[Task], folder: Path) -> list[Task]:
    """Return the ``tasks`` that the journals in ``folder`` lack; lost ones are open again."""
    known = read_journals(sorted(folder.glob(JOURNAL_PATTERN)))
    done = {key for key, record in known.items() if record.status != "lost"}
    return [task for task in tasks if task.key not in done]


def execute_tasks(
    tasks: Sequence[Task],
    engine: Engine,
    journal: Journal,
    folder: Path,
    on_done: Callable[[Record], None],
) -> None:
    """Run ``tasks`` on ``engine`` and write each record as it is done.

    Args:
        tasks: The tasks to run.
        engine: Its workers run them.
        journal: The open journal.
        folder: Folder for the top views.
        on_done: Called with each record after it is written.

    Raises:
        FileError: The disk is full.
        LinkError: The connection to the cluster is lost.
    """
    for done in run_on_workers(tasks, engine):
        if done.picture is not None:
            write_inside(folder, picture_path(folder, done.record), done.picture)
        journal.append(done.record)
        on_done(done.record)


def picture_path(folder: Path, record: Record) -> Path:
    """Return the path of the top view of ``record``."""
    name = f"{record.scene}-{record.variant}-{record.seed}"
    return folder / PICTURES_FOLDER / (re.sub(r"[^\w.-]", "_", name) + ".svg")
