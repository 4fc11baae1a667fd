"""A real Dask cluster on the loopback: a scheduler and two workers, as a user would start them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from short_experiments import busy, children, quick_tasks, wait_for

from scan3d_twin.bench.cluster import ClusterEngine, _check, cluster_engine
from scan3d_twin.bench.engine import run_on_workers
from scan3d_twin.bench.journal import read_journals
from scan3d_twin.bench.record import to_json, without_timings
from scan3d_twin.bench.store import read_results
from scan3d_twin.bench.work import code_hash, run_task
from scan3d_twin.core.errors import ConfigError, LinkError

pytest.importorskip("distributed")

LOCAL = ["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
BEGUN = 0.2
"""Processor time, beyond that of its start, after which a worker is in the middle of a task [s]."""
LONG = 100.0


@contextmanager
def dask(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Dask command in a process of its own until the block ends."""
    command = [sys.executable, "-m", "distributed.cli." + arguments[0], *LOCAL, *arguments[1:]]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, **quiet) as process:  # type: ignore[call-overload]
        yield process
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[int]]]:
    """Address of the scheduler and the processes of the two nannies."""
    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    worker = ["dask_worker", "--scheduler-file", str(file), "--nthreads", "1"]
    place = ["--local-directory", str(folder)]
    with dask("dask_scheduler", "--port", "0", "--scheduler-file", str(file)):
        wait_for(file.is_file)
        with dask(*worker, *place) as one, dask(*worker, *place) as two:
            yield json.loads(file.read_text())["address"], [one.pid, two.pid]


@pytest.fixture
def engine(cluster: tuple[str, list[int]]) -> Iterator[ClusterEngine]:
    """The engine on a cluster of two workers."""
    with cluster_engine(cluster[0], LONG) as opened:
        opened._client.wait_for_workers(2, timeout=60)
        yield opened


def workers(nannies: list[int]) -> list[int]:
    """Return the worker processes: their nannies' children, but for Python's resource tracker."""
    found = [pid for nanny in nannies for pid in children(nanny)]
    return [pid for pid in found if b"resource_tracker" not in _command(pid)]


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b"resource_tracker"


def test_a_cluster_gives_the_same_records(engine: ClusterEngine) -> None:
    tasks = quick_tasks(3)
    assert engine.slots == 2
    there = {
        done.record.seed: without_timings(done.record) for done in run_on_workers(tasks, engine)
    }
    assert there == {task.seed: without_timings(run_task(task).record) for task in tasks}


def test_a_killed_worker_of_a_cluster_loses_nothing(
    engine: ClusterEngine, cluster: tuple[str, list[int]]
) -> None:
    before = {pid: busy(pid) for pid in workers(cluster[1])}
    assert len(before) == 2

    def kill_one() -> None:
        """Kill the worker that computes."""
        wait_for(lambda: any(busy(pid) > spent + BEGUN for pid, spent in before.items()))
        os.kill(max(before, key=lambda pid: busy(pid) - before[pid]), signal.SIGKILL)

    killer = threading.Thread(target=kill_one)
    killer.start()
    done = list(run_on_workers(quick_tasks(4), engine))
    killer.join()
    assert set(before) != set(workers(cluster[1]))
    assert sorted(each.record.seed for each in done) == [0, 1, 2, 3]
    assert all(each.record.status == "done" for each in done)


def test_a_killed_driver_of_a_cluster_goes_on(
    cluster: tuple[str, list[int]], tmp_path: Path
) -> None:
    options = ["--scenes", "shiny_cylinder", "--presets", "paper", "--max-views", "1"]
    where = ["--cluster", cluster[0], "--out", str(tmp_path)]
    program = [sys.executable, "-m", "scan3d_twin.cli", "bench"]
    command = [*program, *options, "--seeds", "4", *where]
    journal = tmp_path / "journal.jsonl"
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as driver:
        wait_for(lambda: journal.exists() and b"\n" in journal.read_bytes())
        driver.kill()
    before = read_journals([journal])
    assert 0 < len(before) < 4
    again = subprocess.run(command, check=True, capture_output=True, text=True, timeout=100)
    assert f"{len(before)} of 4 runs are done already" in again.stderr
    records = read_results(tmp_path)
    assert [record.seed for record in records] == [0, 1, 2, 3]
    assert {record.status for record in records} == {"done"}
    assert set(map(to_json, before.values())) <= set(map(to_json, records))


def test_a_hanging_task_of_a_cluster_is_ended(cluster: tuple[str, list[int]]) -> None:
    (task,) = quick_tasks(1)
    with cluster_engine(cluster[0], 0.05) as hurried:
        (done,) = run_on_workers([task], hurried, retries=0)
    assert done.record.status == "lost"
    assert done.record.stop == "not finished after 0.05 s"
    with cluster_engine(cluster[0], LONG) as patient:
        (again,) = run_on_workers([task], patient)
    assert again.record.status == "done"


def test_nobody_there_is_told_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scan3d_twin.bench.cluster.CONNECT_TIMEOUT", 1.0)
    refused = pytest.raises(LinkError, match="start one with `dask scheduler`")
    with refused, cluster_engine("tcp://127.0.0.1:9", LONG):
        pass


def test_workers_with_other_sources_are_refused(engine: ClusterEngine) -> None:
    _check(engine._client, "here", code_hash())
    with pytest.raises(ConfigError, match="runs other sources"):
        _check(engine._client, "here", "0" * 12)
