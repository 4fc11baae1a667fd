"""The course of an experiment: what is left to do, done and written down, run by run."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from scan3d_twin.bench.engine import Engine, run_on_workers
from scan3d_twin.bench.journal import JOURNAL_PATTERN, Journal, read_journals
from scan3d_twin.bench.record import Record
from scan3d_twin.bench.task import Task
from scan3d_twin.run.folder import write_file

PICTURES_FOLDER = "top_views"
"""Folder of the top views of each variant's first seed."""


def find_open_tasks(tasks: Sequence[Task], folder: Path) -> list[Task]:
    """Return those of ``tasks`` that no journal in ``folder`` has; lost ones are tried again."""
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
    """Run ``tasks`` on ``engine`` and write down each as it is done.

    Args:
        tasks: What is to be run.
        engine: Whose workers.
        journal: Open.
        folder: For the top views.
        on_done: Told about each record once it is written.

    Raises:
        FileError: The disk is full.
        LinkError: The cluster is gone.
    """
    for done in run_on_workers(tasks, engine):
        if done.picture is not None:
            write_file(picture_path(folder, done.record), done.picture)
        journal.append(done.record)
        on_done(done.record)


def picture_path(folder: Path, record: Record) -> Path:
    """Return where the top view of ``record`` is kept."""
    name = f"{record.scene}-{record.variant}-{record.seed}"
    return folder / PICTURES_FOLDER / (re.sub(r"[^\w.-]", "_", name) + ".svg")
