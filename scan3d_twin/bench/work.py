"""Runs one task in a worker: from the settings to the record."""

from __future__ import annotations

import hashlib
import platform
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import scan3d_twin
from scan3d_twin.bench.features import feature_score_before
from scan3d_twin.bench.record import Record, Step
from scan3d_twin.bench.task import Task
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.model.evaluation import Evaluation, Reference, evaluate_model
from scan3d_twin.core.model.fused_cloud import Model, build_model
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.session import Session
from scan3d_twin.run.closed_loop import LoopOutcome, close_loop
from scan3d_twin.run.resolve import load_run_scene
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.viz.top_view import draw_top_view

COMPLETE_REASONS = ("front complete", "contour complete")
"""Beginnings of the stop reasons of a complete scan."""


@dataclass(frozen=True)
class TaskResult:
    """The result of a task.

    Attributes:
        record: The record.
        picture: The top view as SVG; None where it was not wanted or nothing was seen.
    """

    record: Record
    picture: str | None = None


def run_task(task: Task) -> TaskResult:
    """Run ``task`` and return its result; a failed scan is a result too.

    Raises:
        Exception: A bug; errors of a robot or a scene are in the record.
    """
    # Run the closed loop
    wall, cpu = time.perf_counter(), time.process_time()
    run = task.settings.run
    try:
        scene = load_run_scene(run)
        with open_sim(scene, run.seed, task.settings.twin) as (robot, truth):
            loop = close_loop(robot, truth, task.settings, Unobserved(), time.process_time)
    except TwinError as error:
        blank = replace(task.blank_record(), stop=f"{type(error).__name__}: {error}")
        return TaskResult(_add_provenance(blank, wall, cpu))

    # Raise what is a bug
    if loop.ended is not None and not isinstance(loop.ended, TwinError):
        raise loop.ended

    # Evaluate and draw the result
    seen = any(len(view.target) for view in loop.session.views)
    model = build_model(loop.session)
    evaluation = None
    if seen:
        reference = Reference.of(loop.session, truth, run.target)
        evaluation = evaluate_model(loop.session, model, reference)
    record = _fill_record(task.blank_record(), loop, model, evaluation)
    picture = _draw_picture(task, record, loop.session, model) if task.picture and seen else None
    return TaskResult(_add_provenance(record, wall, cpu), picture)


def _fill_record(
    blank: Record, loop: LoopOutcome, model: Model, evaluation: Evaluation | None
) -> Record:
    """Return the record of ``loop``; without ``evaluation`` no view showed the target."""
    # Fill in the loop
    errors = [pair.error for pair in evaluation.pairs] if evaluation else []
    record = replace(
        blank,
        status="failed" if loop.ended else "done",
        stop=loop.session.stop_reason,
        complete=loop.session.stop_reason.startswith(COMPLETE_REASONS),
        views=len(loop.session.views),
        success=evaluation is not None and evaluation.is_success(blank.epsilon),
        max_error=max(errors, default=None),
        path=loop.journey.path,
        turn=loop.journey.turn,
        duration=loop.journey.duration,
        plan_cpu=sum(loop.plan_times),
        steps=tuple(_step(loop, k, evaluation) for k in range(len(loop.session.views))),
    )

    # Add the quality of the model
    return record if evaluation is None else replace(record, **_quality(model, evaluation))


def _quality(model: Model, evaluation: Evaluation) -> dict[str, Any]:
    return {
        "coverage": evaluation.coverage,
        "coverable_share": evaluation.coverable_share,
        **{f"f{1e3 * d:.0f}": score for d, score in evaluation.f_score.items()},
        "accuracy": evaluation.accuracy.median,
        "accuracy_p95": evaluation.accuracy.p95,
        "completeness": evaluation.completeness.median,
        "completeness_p95": evaluation.completeness.p95,
        "points": len(model),
    }


def _step(loop: LoopOutcome, k: int, evaluation: Evaluation | None) -> Step:
    """Return the row of view ``k``."""
    # Take pose and journey
    view, journey = loop.session.views[k], loop.journeys[k]
    step = Step(
        view=k,
        x=view.T_world_scan.x,
        y=view.T_world_scan.y,
        yaw=view.T_world_scan.yaw,
        path=journey.path,
        turn=journey.turn,
        time=journey.duration,
        coverage=evaluation.coverage_by_view[k] if evaluation else None,
        plan_cpu=loop.plan_times[k] if k < len(loop.plan_times) else None,
        feature=feature_score_before(loop.session, k),
    )

    # Add the registration
    return step if k == 0 else replace(step, **_registered(loop.session, k, evaluation))


def _registered(session: Session, k: int, evaluation: Evaluation | None) -> dict[str, Any]:
    """Return the plan of view ``k`` and the errors of its registration, as fields of a step."""
    # Take plan and registration
    plan, result = session.plans[k - 1], session.views[k].registration
    planned = {
        "overlap": plan.overlap,
        "predicted": plan.predicted_rmse,
        "fell_back": plan.fell_back,
        "candidates": len(plan.candidates),
    }
    if result is not None:
        planned |= {
            "expected": result.predicted_rmse,
            "fitness": result.fitness,
            "converged": result.converged,
            "open_directions": len(result.degenerate_directions),
        }

    # Add errors against the truth
    if evaluation is None:
        return planned
    pair = evaluation.pairs[k - 1]
    errors = {name: getattr(pair, name) for name in ("error", "pose_error", "odometry_error")}
    return planned | errors


def _draw_picture(task: Task, record: Record, session: Session, model: Model) -> str:
    return draw_top_view(
        model.points,
        model.view,
        [each.T_world_scan for each in session.views],
        sweep_width=session.config.sweep.width,
        standoff=session.config.planning.standoff,
        title=f"{task.scene}, {task.variant}, seed {task.seed}: {record.views} views, "
        f"{record.coverage:.0%} covered",
    )


def _add_provenance(record: Record, wall: float, cpu: float) -> Record:
    """Return ``record`` with its computing time and the version of the software."""
    return replace(
        record,
        wall=time.perf_counter() - wall,
        cpu=time.process_time() - cpu,
        code=code_hash(),
        python=platform.python_version(),
    )


@cache
def code_hash() -> str:
    """Return a hash of the package's sources: results of different sources must not be mixed."""
    digest = hashlib.sha256()
    root = Path(scan3d_twin.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()[:12]
