"""Made-up records of runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from short_experiments import quick_tasks

from scan3d_twin.bench.record import Record, Step
from scan3d_twin.bench.task import Task

Make = Callable[..., Record]


@pytest.fixture(scope="session")
def a_task() -> Task:
    """A task of about a second."""
    return quick_tasks(1)[0]


@pytest.fixture(scope="session")
def make(a_task: Task) -> Make:
    """Make up the record of a run: its views, their errors [m] and what else is stated."""

    def made(
        variant: str = "a",
        seed: int = 0,
        errors: tuple[float, ...] = (0.004, 0.008),
        **stated: object,
    ) -> Record:
        """Return a record of a run with these errors."""
        steps = tuple(_step(k, error) for k, error in enumerate((None, *errors)))
        record = replace(
            a_task.blank_record(),
            key=f"{variant}-{seed}",
            variant=variant,
            seed=seed,
            status="done",
            stop="front complete",
            complete=True,
            views=len(steps),
            success=max(errors, default=1.0) <= 0.010,
            max_error=max(errors, default=None),
            coverage=0.9,
            f20=0.95,
            path=1.0,
            turn=2.0,
            duration=60.0 + seed,
            plan_cpu=0.1,
            steps=steps,
        )
        return replace(record, **stated)

    return made


def _step(k: int, error: float | None) -> Step:
    step = Step(
        view=k, x=0.1 * k, y=0.5 * k, yaw=0.2, path=float(k), turn=0.1, time=30.0 * (k + 1),
        coverage=round(0.3 * (k + 1), 6), plan_cpu=0.02, feature=0.05 * (k + 1),
    )  # fmt: skip
    if error is None:
        return step
    return replace(
        step, overlap=0.2 + 0.1 * k, predicted=0.5 * error, error=error, pose_error=error,
        odometry_error=0.03, fitness=0.8, converged=True, fell_back=False, candidates=3,
    )  # fmt: skip
