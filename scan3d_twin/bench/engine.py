"""Tasks on workers: kept busy, lost ones begun again; whose workers these are is the engine's."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, Protocol

from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import TaskResult

MAX_RETRIES = 2
"""A task whose worker is lost is begun so many times more: one loss may be an accident."""


class WorkerLostError(Exception):
    """The worker died, or had to be killed because its time was over; the message says which."""


class Engine(Protocol):
    """Somebody's workers."""

    @property
    def slots(self) -> int:
        """How many tasks may be under way at once, so that no worker waits."""
        ...

    def submit(self, task: Task) -> Future[TaskResult]:
        """Begin ``task`` when a worker is free; ``WorkerLostError`` when the worker is lost."""
        ...

    def wait(self, futures: Collection[Future[TaskResult]]) -> Collection[Future[TaskResult]]:
        """Wait for one of ``futures`` and return those that are finished."""
        ...


def run_on_workers(
    tasks: Iterable[Task], engine: Engine, retries: int = MAX_RETRIES
) -> Iterator[TaskResult]:
    """Yield what came of each of ``tasks``, as it comes."""
    waiting = deque((task, 1) for task in tasks)
    running: dict[Future[TaskResult], tuple[Task, int]] = {}
    while waiting or running:
        while waiting and len(running) < engine.slots:
            task, attempt = waiting.popleft()
            running[engine.submit(task)] = task, attempt
        for future in engine.wait(running):
            task, attempt = running.pop(future)
            done = _outcome(future, task, attempt)
            if done.record.status == "lost" and _is_worth_a_retry(future) and attempt <= retries:
                waiting.append((task, attempt + 1))
            else:
                yield done


def _outcome(future: Future[Any], task: Task, attempt: int) -> TaskResult:
    """Return the result of ``future``; that of a lost worker or of a bug is a lost task."""
    error = future.exception()
    if error is None:
        done: TaskResult = future.result()
        return replace(done, record=replace(done.record, attempts=attempt))
    words = str(error) if isinstance(error, WorkerLostError) else f"bug: {error!r}"
    return TaskResult(task.lost(words, attempt))


def _is_worth_a_retry(future: Future[Any]) -> bool:
    """Tell whether it may end otherwise next time: a bug will not."""
    return isinstance(future.exception(), WorkerLostError)
