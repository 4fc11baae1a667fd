"""Workers on this computer: a pool of processes that survives the loss of one."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from scan3d_twin.bench.engine import WorkerLostError
from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import TaskResult, run_task
from scan3d_twin.core.errors import ConfigError

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that limit a worker to one thread: the arrays are small, more threads slow it down."""


@contextmanager
def local_engine(jobs: int, timeout: float) -> Iterator[LocalEngine]:
    """Open ``jobs`` workers with a time limit of ``timeout`` [s] per task; they end with the block.

    Raises:
        ConfigError: The process pool is not installed.
    """
    with _environment(dict.fromkeys(THREAD_VARIABLES, "1")):
        engine = LocalEngine(jobs, timeout)
        try:
            yield engine
        finally:
            engine.stop()


class LocalEngine:
    """A pool of processes; see ``Engine``."""

    def __init__(self, jobs: int, timeout: float) -> None:
        self._jobs = jobs
        self._timeout = timeout
        self._pool = self._open()

    @property
    def slots(self) -> int:
        """See ``Engine``: one running and one queued task per worker."""
        return 2 * self._jobs

    def submit(self, task: Task) -> Future[TaskResult]:
        """See ``Engine``."""
        outer: Future[TaskResult] = Future()
        try:
            inner = self._pool.schedule(run_task, args=(task,), timeout=self._timeout)
        except (BrokenProcessPool, RuntimeError):
            # A pool breaks when its last idle worker is killed; the tasks are not to blame.
            self.stop()
            self._pool = self._open()
            inner = self._pool.schedule(run_task, args=(task,), timeout=self._timeout)
        inner.add_done_callback(lambda future: _pass_on(future, outer, self._timeout))
        return outer

    def wait(self, futures: Collection[Future[TaskResult]]) -> Collection[Future[TaskResult]]:
        """See ``Engine``."""
        return wait(futures, return_when=FIRST_COMPLETED).done

    def stop(self) -> None:
        """End all workers at once."""
        self._pool.stop()
        self._pool.join()

    def _open(self) -> Any:
        try:
            from pebble import ProcessPool
        except ImportError:
            raise ConfigError(
                "the process pool is not installed: pip install pebble duckdb"
            ) from None
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["scan3d_twin.bench.work"])
        return ProcessPool(max_workers=self._jobs, context=context)


def _pass_on(inner: Future[TaskResult], outer: Future[TaskResult], timeout: float) -> None:
    """Set the result or the error of ``outer`` from the pool's ``inner`` future."""
    from pebble import ProcessExpired

    if inner.cancelled():
        outer.set_exception(WorkerLostError("the bench was stopped"))
        return
    error = inner.exception()
    if error is None:
        outer.set_result(inner.result())
    elif isinstance(error, ProcessExpired):
        outer.set_exception(WorkerLostError(f"the worker died, exit code {error.exitcode}"))
    elif isinstance(error, BrokenProcessPool):
        outer.set_exception(WorkerLostError("all workers died"))
    elif isinstance(error, TimeoutError):
        outer.set_exception(WorkerLostError(f"not finished after {timeout:g} s"))
    else:
        outer.set_exception(error)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes that are started in the block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
