"""Workers of a Dask cluster that is already running.

A task that hangs is ended by restarting its worker, which needs the worker's nanny (the default).
Dask sends pickled Python objects without authentication: use a private network, or TLS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import Any

from scan3d_twin.bench.engine import WorkerLostError
from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import TaskResult, code_hash, run_task
from scan3d_twin.core.errors import ConfigError, LinkError

CONNECT_TIMEOUT = 15.0
"""Time for the scheduler to answer [s]; over loopback it takes 2."""
WORKER_TIMEOUT = 60.0
"""Time for a worker to register [s]; on an idle computer it takes 5."""
POLL_PERIOD = 0.5
"""Time between two checks for overdue tasks [s]."""


@contextmanager
def cluster_engine(address: str, timeout: float) -> Iterator[ClusterEngine]:
    """Open the cluster whose scheduler is at ``address``, such as tcp://10.0.0.1:8786.

    Raises:
        ConfigError: Dask is not installed here, or the workers run other sources.
        LinkError: The scheduler does not answer, or has no workers.
    """
    # Connect to the scheduler
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError(
            "the cluster's client is not installed: pip install distributed"
        ) from None
    try:
        client: Any = Client(address, timeout=CONNECT_TIMEOUT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise LinkError(
            f"no Dask scheduler answers at {address}; start one with `dask scheduler`"
        ) from error

    # Check the workers and serve
    with client:
        _check(client, address, code_hash())
        yield ClusterEngine(client, address, timeout)


def _check(client: Any, address: str, here: str) -> None:
    """Raise if there are no workers, or the sources of one differ from the hash ``here``."""
    # Wait for the first worker
    try:
        client.wait_for_workers(1, timeout=WORKER_TIMEOUT)
    except TimeoutError as error:
        raise LinkError(
            f"{address} has no workers; start some with `dask worker {address} --nthreads 1`"
        ) from error
    try:
        codes = client.run(code_hash)
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"a worker of {address} cannot run scan3d_twin ({error}); install this version there"
        ) from error

    # Compare their sources
    for worker, code in codes.items():
        if code != here:
            raise ConfigError(
                f"the worker {worker} runs other sources of scan3d_twin ({code}) than those here "
                f"({here}); install this version there"
            )


class ClusterEngine:
    """A cluster's workers; see ``Engine``."""

    def __init__(self, client: Any, address: str, timeout: float) -> None:
        self._client = client
        self._address = address
        self._timeout = timeout
        self._inner: dict[Future[TaskResult], Any] = {}
        self._begun: dict[Future[TaskResult], float] = {}

    @property
    def slots(self) -> int:
        """See ``Engine``: one task per thread, so that every submitted task is running."""
        threads: dict[str, int] = self._ask(self._client.nthreads)
        return max(1, sum(threads.values()))

    def submit(self, task: Task) -> Future[TaskResult]:
        """See ``Engine``."""
        outer: Future[TaskResult] = Future()
        self._inner[outer] = self._ask(lambda: self._client.submit(run_task, task, pure=False))
        self._begun[outer] = time.monotonic()
        return outer

    def wait(self, futures: Collection[Future[TaskResult]]) -> Collection[Future[TaskResult]]:
        """See ``Engine``."""
        from distributed import wait

        while True:
            try:
                inner = [self._inner[future] for future in futures]
                wait(inner, timeout=POLL_PERIOD, return_when="FIRST_COMPLETED")  # type: ignore[no-untyped-call]
            except TimeoutError:
                self._end_overdue(futures)
            except CancelledError as error:
                raise self._gone() from error
            finished = [f for f in futures if f.done() or self._inner[f].done()]
            for future in finished:
                self._settle(future)
            if finished:
                return finished
            self._ask(self._client.nthreads)

    def _settle(self, outer: Future[TaskResult]) -> None:
        """Set the result or the error of ``outer`` from its Dask task."""
        # Forget the task
        inner = self._inner.pop(outer)
        del self._begun[outer]
        if outer.done():
            return
        if inner.status == "cancelled":
            raise self._gone()

        # Pass on result or error
        error = inner.exception()
        if error is None:
            outer.set_result(inner.result())
        elif type(error).__name__ == "KilledWorker":
            outer.set_exception(WorkerLostError("its workers died again and again"))
        else:
            outer.set_exception(error)

    def _end_overdue(self, futures: Collection[Future[TaskResult]]) -> None:
        """Give up overdue tasks, and restart the workers that hang on them."""
        # Find the overdue tasks
        now = time.monotonic()
        overdue = [f for f in futures if now - self._begun[f] > self._timeout]
        if not overdue:
            return

        # Find the workers that hang
        keys = {self._inner[future].key for future in overdue}
        workers = [w for w, mine in self._client.processing().items() if keys & set(mine)]

        # Give up tasks, restart workers
        for future in overdue:
            self._inner[future].cancel()
            future.set_exception(WorkerLostError(f"not finished after {self._timeout:g} s"))
        if workers:
            self._client.restart_workers(workers, timeout=WORKER_TIMEOUT, raise_for_error=False)

    def _ask(self, question: Callable[[], Any]) -> Any:
        """Return the scheduler's answer, with Dask's errors as ``LinkError``."""
        try:
            return question()
        except (OSError, RuntimeError, CancelledError) as error:
            raise self._gone() from error

    def _gone(self) -> LinkError:
        return LinkError(
            f"the Dask scheduler at {self._address} is gone; finished runs are kept, and the same "
            "command goes on"
        )
