"""Test helper: short experiments for `twin bench`, and the processes they run in."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from scan3d_twin.bench.spec import list_tasks, make_experiment
from scan3d_twin.bench.task import Task


def quick_tasks(seeds: int, views: int = 1) -> list[Task]:
    """Return tasks of about a second each, without pictures."""
    experiment = make_experiment(["shiny_cylinder"], [], ["paper"]).with_seeds(seeds, 0)
    chosen = list_tasks(experiment.with_options({"max_views": views}))
    return [replace(task, picture=False) for task in chosen]


def children(pid: int) -> list[int]:
    """Return the processes that any thread of ``pid`` began."""
    listed = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(each) for text in listed for each in text.split()]


def busy(pid: int) -> float:
    """Return the processor time of ``pid`` [s]; 0 when it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / 100


def wait_for(ready: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait until ``ready``; fail after ``seconds``."""
    deadline = time.monotonic() + seconds
    while not ready():
        assert time.monotonic() < deadline
        time.sleep(0.02)
