"""Progress of a bench on standard error: a bar with the time left, or lines off a terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from scan3d_twin.cli.output import say
from scan3d_twin.cli.summary import count

if TYPE_CHECKING:
    from scan3d_twin.bench.record import Record

SPEED_WINDOW = 600.0
"""The time left is estimated from the speed in this last stretch [s]."""


class BenchProgress(Protocol):
    """What finished runs are reported to; ``count`` is how many there are."""

    count: int

    def done(self, record: Record) -> None:
        """Report a run that is done."""
        ...


@contextmanager
def bench_progress(total: int, before: int) -> Iterator[BenchProgress]:
    """Open the progress that fits standard error; ``before`` of ``total`` runs are done."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal or console.is_dumb_terminal:
        yield PlainProgress(total, before)
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, speed_estimate_period=SPEED_WINDOW) as bar:
        yield LiveProgress(bar, bar.add_task("runs", total=total, completed=before), before)


class PlainProgress:
    """One line per run."""

    def __init__(self, total: int, before: int) -> None:
        self.count = before
        self._total, self._before = total, before
        self._started = time.monotonic()
        if before:
            say(f"{before} of {total} runs are done already")

    def done(self, record: Record) -> None:
        """See ``BenchProgress``."""
        self.count += 1
        each = (time.monotonic() - self._started) / (self.count - self._before)
        left = each * (self._total - self.count)
        say(f"{self.count}/{self._total}, {_duration(left)} left: {run_words(record)}")


class LiveProgress:
    """A bar; runs that failed are listed above it."""

    def __init__(self, bar: Progress, task: TaskID, before: int) -> None:
        self.count = before
        self._bar, self._task = bar, task

    def done(self, record: Record) -> None:
        """See ``BenchProgress``."""
        self.count += 1
        self._bar.update(self._task, advance=1, description=f"{record.scene} {record.variant}")
        if record.status != "done":
            self._bar.console.print(run_words(record), markup=False)


def run_words(record: Record) -> str:
    """Return a run in a line."""
    which = f"{record.scene} {record.variant} seed {record.seed}"
    if record.status != "done":
        return f"{which}: {record.status.upper()}, {record.stop}"
    worst = "-" if record.max_error is None else f"{1e3 * record.max_error:.1f} mm"
    views = count(record.views, "view")
    return f"{which}: {views}, worst error {worst}, surface {record.coverage:.0%} covered"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
