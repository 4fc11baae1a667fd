"""Runs tasks on the workers of an engine: keeps them busy, retries tasks of lost workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, Protocol

from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import TaskResult

MAX_RETRIES = 2
"""Retries of a task whose worker was lost: a single loss may be an accident."""


class WorkerLostError(Exception):
    """A worker died, or was killed because of its time limit; the message says which."""


class Engine(Protocol):
    """A pool of workers: processes on this computer, or a cluster."""

    @property
    def slots(self) -> int:
        """Number of tasks to submit at once so that no worker is idle."""
        ...

    def submit(self, task: Task) -> Future[TaskResult]:
        """Submit ``task``; the future raises ``WorkerLostError`` when the worker is lost."""
        ...

    def wait(self, futures: Collection[Future[TaskResult]]) -> Collection[Future[TaskResult]]:
        """Wait for one of ``futures`` and return those that are finished."""
        ...


def run_on_workers(
    tasks: Iterable[Task], engine: Engine, retries: int = MAX_RETRIES
) -> Iterator[TaskResult]:
    """Run ``tasks`` on ``engine`` and yield each result as it is done."""
    waiting = deque((task, 1) for task in tasks)
    running: dict[Future[TaskResult], tuple[Task, int]] = {}
    while waiting or running:
        # Keep all workers busy
        while waiting and len(running) < engine.slots:
            task, attempt = waiting.popleft()
            running[engine.submit(task)] = task, attempt

        # Yield results, retry lost tasks
        for future in engine.wait(running):
            task, attempt = running.pop(future)
            done = _outcome(future, task, attempt)
            if done.record.status == "lost" and _is_worth_a_retry(future) and attempt <= retries:
                waiting.append((task, attempt + 1))
            else:
                yield done


def _outcome(future: Future[Any], task: Task, attempt: int) -> TaskResult:
    """Return the result of ``future``; after a lost worker or a bug the record of a lost task."""
    error = future.exception()
    if error is None:
        done: TaskResult = future.result()
        return replace(done, record=replace(done.record, attempts=attempt))
    words = str(error) if isinstance(error, WorkerLostError) else f"bug: {error!r}"
    return TaskResult(task.lost_record(words, attempt))


def _is_worth_a_retry(future: Future[Any]) -> bool:
    """Return whether a retry can succeed: after a lost worker, not after a bug."""
    return isinstance(future.exception(), WorkerLostError)
