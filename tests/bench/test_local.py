"""Workers on this computer, and what is left when one of them is gone."""

from __future__ import annotations

import multiprocessing.forkserver
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace

import pytest
from short_experiments import busy, children, quick_tasks, wait_for

from scan3d_twin.bench.engine import run_on_workers
from scan3d_twin.bench.local import LocalEngine, local_engine
from scan3d_twin.bench.record import without_timings
from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import TaskResult, run_task

BEGUN = 0.2
"""Processor time after which a worker is in the middle of a task [s]."""
LONG = 100.0
"""Longer than any of these tasks takes on a crowded computer [s]."""


def workers() -> list[int]:
    """Return the process ids of the pool's workers."""
    server = multiprocessing.forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    return children(server) if server else []


def while_running(tasks: list[Task], timeout: float, act: Callable[[], None]) -> list[TaskResult]:
    """Return what came of ``tasks`` on two workers, and ``act`` meanwhile."""
    with local_engine(2, timeout) as engine:
        actor = threading.Thread(target=act)
        actor.start()
        done = list(run_on_workers(tasks, engine))
        actor.join()
    return done


def test_results_are_those_of_this_process_whichever_worker_made_them() -> None:
    tasks = quick_tasks(3)
    done = while_running(tasks, LONG, lambda: None)
    there = {each.record.seed: without_timings(each.record) for each in done}
    here = {task.seed: without_timings(run_task(task).record) for task in tasks}
    assert there == here
    assert len({str(row) for row in here.values()}) == 3


def test_a_killed_worker_loses_only_its_task_and_that_is_begun_again() -> None:
    def kill_one() -> None:
        """Kill the worker that computes."""
        wait_for(lambda: any(busy(pid) > BEGUN for pid in workers()))
        os.kill(max(workers(), key=busy), signal.SIGKILL)

    done = while_running(quick_tasks(4), LONG, kill_one)
    assert sorted(each.record.seed for each in done) == [0, 1, 2, 3]
    assert all(each.record.status == "done" for each in done)
    assert sorted(each.record.attempts for each in done) == [1, 1, 1, 2]


def test_a_hanging_worker_is_ended_and_its_task_begun_again() -> None:
    def stop_one() -> None:
        """Stop the worker that computes, so that it hangs."""
        wait_for(lambda: any(busy(pid) > BEGUN for pid in workers()))
        os.kill(max(workers(), key=busy), signal.SIGSTOP)

    done = while_running(quick_tasks(3), 10.0, stop_one)
    assert sorted(each.record.seed for each in done) == [0, 1, 2]
    assert all(each.record.status == "done" for each in done)
    assert max(each.record.attempts for each in done) > 1


def test_a_pool_without_workers_is_opened_anew() -> None:
    first, second = quick_tasks(2)
    with local_engine(1, LONG) as engine:
        (done,) = run_on_workers([first], engine)
        for pid in workers():
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: not engine._pool.active or bool(set(workers())))
        (again,) = run_on_workers([second], engine)
    assert (done.record.status, again.record.status) == ("done", "done")


def test_what_never_ends_is_lost_after_three_attempts_and_says_so() -> None:
    (task,) = quick_tasks(1)
    with local_engine(1, 0.05) as engine:
        (done,) = run_on_workers([task], engine)
    assert done.record.status == "lost"
    assert done.record.attempts == 3
    assert done.record.stop == "not finished after 0.05 s"
    assert (done.record.key, done.record.seed) == (task.key, task.seed)


def test_a_bug_loses_its_task_at_once_and_no_other() -> None:
    """An object that is no task stands for a bug that only one task meets."""
    good, bad = quick_tasks(2)
    broken = replace(bad, settings=replace(bad.settings, config=None))  # type: ignore[arg-type]

    class Engine(LocalEngine):
        """An engine whose task has a bug."""

        def submit(self, task: Task) -> Future[TaskResult]:
            """Return a future that has failed."""
            return super().submit(broken if task is bad else task)

    engine = Engine(1, LONG)
    try:
        done = {each.record.seed: each.record for each in run_on_workers([good, bad], engine)}
    finally:
        engine.stop()
    assert done[good.seed].status == "done"
    assert done[bad.seed].status == "lost"
    assert done[bad.seed].attempts == 1
    assert done[bad.seed].stop.startswith("bug: AttributeError")


def test_a_scan_that_cannot_go_on_is_a_result() -> None:
    (task,) = quick_tasks(1)
    lost = replace(task.settings.run, target="9,9")
    done = run_task(replace(task, settings=replace(task.settings, run=lost)))
    assert done.record.status == "failed"
    assert "Error: " in done.record.stop
    assert (done.record.views, done.record.success, done.record.coverage) == (0, False, 0.0)


def test_no_environment_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    with local_engine(1, LONG):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert "OMP_NUM_THREADS" not in os.environ
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
