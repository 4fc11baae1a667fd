"""Workers of a Dask cluster that somebody else started.

A task that hangs is ended by restarting its worker, which needs the worker's nanny (the default).
Dask sends Python objects and trusts whoever it talks to: private networks, or TLS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import Any

from scan3d_twin.bench.engine import WorkerLostError
from scan3d_twin.bench.task import Task
from scan3d_twin.bench.work import Done, code_hash, perform
from scan3d_twin.core.errors import ConfigError, LinkError

CONNECT_TIMEOUT = 15.0
"""For the scheduler to answer [s]; a loopback takes 2."""
WORKER_TIMEOUT = 60.0
"""For a worker to come [s]; one begins in 5 on a quiet computer."""
POLL = 0.5
"""Time between two looks at the clock of the tasks [s]."""


@contextmanager
def cluster_engine(address: str, timeout: float) -> Iterator[ClusterEngine]:
    """Open the cluster whose scheduler is at ``address``, such as tcp://10.0.0.1:8786.

    Raises:
        ConfigError: Dask is not installed here, or the workers run other sources.
        LinkError: Nobody answers, or no worker comes.
    """
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
    with client:
        _check(client, address, code_hash())
        yield ClusterEngine(client, address, timeout)


def _check(client: Any, address: str, here: str) -> None:
    """Raise if there are no workers, or some whose sources have another hash than ``here``."""
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
        self._inner: dict[Future[Done], Any] = {}
        self._begun: dict[Future[Done], float] = {}

    @property
    def slots(self) -> int:
        """See ``Engine``: one task a thread, so that what is under way is running."""
        threads: dict[str, int] = self._ask(self._client.nthreads)
        return max(1, sum(threads.values()))

    def submit(self, task: Task) -> Future[Done]:
        """See ``Engine``."""
        outer: Future[Done] = Future()
        self._inner[outer] = self._ask(lambda: self._client.submit(perform, task, pure=False))
        self._begun[outer] = time.monotonic()
        return outer

    def wait(self, futures: Collection[Future[Done]]) -> Collection[Future[Done]]:
        """See ``Engine``."""
        from distributed import wait

        while True:
            try:
                inner = [self._inner[future] for future in futures]
                wait(inner, timeout=POLL, return_when="FIRST_COMPLETED")  # type: ignore[no-untyped-call]
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

    def _settle(self, outer: Future[Done]) -> None:
        """Give ``outer`` the outcome of its task, in the engine's words."""
        inner = self._inner.pop(outer)
        del self._begun[outer]
        if outer.done():
            return
        if inner.status == "cancelled":
            raise self._gone()
        error = inner.exception()
        if error is None:
            outer.set_result(inner.result())
        elif type(error).__name__ == "KilledWorker":
            outer.set_exception(WorkerLostError("its workers died again and again"))
        else:
            outer.set_exception(error)

    def _end_overdue(self, futures: Collection[Future[Done]]) -> None:
        """Give up tasks whose time is over, and restart the workers that hang on them."""
        now = time.monotonic()
        overdue = [f for f in futures if now - self._begun[f] > self._timeout]
        if not overdue:
            return
        keys = {self._inner[future].key for future in overdue}
        workers = [w for w, mine in self._client.processing().items() if keys & set(mine)]
        for future in overdue:
            self._inner[future].cancel()
            future.set_exception(WorkerLostError(f"not finished after {self._timeout:g} s"))
        if workers:
            self._client.restart_workers(workers, timeout=WORKER_TIMEOUT, raise_for_error=False)

    def _ask(self, question: Callable[[], Any]) -> Any:
        """Return the scheduler's answer."""
        try:
            return question()
        except (OSError, RuntimeError, CancelledError) as error:
            raise self._gone() from error

    def _gone(self) -> LinkError:
        return LinkError(
            f"the Dask scheduler at {self._address} is gone; finished runs are kept, and the same "
            "command goes on"
        )
