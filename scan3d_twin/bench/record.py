"""The record of one closed loop: a row of the journal and of the Parquet file.

SI units and radians, as everywhere inside. Two runs of one task give the same record, except for
``TIMING_FIELDS``. Null stands for a value that was not measured or is not finite.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

Status = Literal["done", "failed", "lost"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One view of a run, and the plan that led to it; the first view has no plan and no errors.

    Attributes:
        view: Index, from 0.
        x, y, yaw: ``T_world_scan`` [m, rad].
        path: Path by the end of the view [m].
        turn: Sum of turns by the end of the view [rad].
        time: Time on the robot's clock at the end of the view [s].
        coverage: Share of the coverable surface that this and the earlier views cover.
        plan_cpu: Processor time of the planner after this view [s].
        feature: Feature score of the surface that the next view had to overlap (curvature.py).
        overlap: The overlap eta chosen for this view.
        predicted: Error E predicted by the planner [m].
        expected: Error E predicted by the registration from its own covariance [m].
        error: Error of the registration against the truth [m].
        pose_error: Error of the pose in the world, after the final alignment [m].
        odometry_error: Error of the odometry, before registration [m].
        fitness: Share of points with a correspondence.
        converged: Whether the registration did.
        open_directions: Number of directions in which only odometry determines the pose.
        fell_back: Whether no overlap met epsilon.
        candidates: Number of viewpoints that the planner considered.
    """

    view: int
    x: float
    y: float
    yaw: float
    path: float
    turn: float
    time: float
    coverage: float | None = None
    plan_cpu: float | None = None
    feature: float | None = None
    overlap: float | None = None
    predicted: float | None = None
    expected: float | None = None
    error: float | None = None
    pose_error: float | None = None
    odometry_error: float | None = None
    fitness: float | None = None
    converged: bool | None = None
    open_directions: int | None = None
    fell_back: bool | None = None
    candidates: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One closed loop.

    Attributes:
        key: Hash of the effective task.
        variant, scene, seed: The run's place in the experiment.
        planner, preset, world, tour, scope, engine: Settings to compare by.
        epsilon, lambda_, gamma, sigma, standoff: Settings with units [m, 1, 1, m, m].
        trials: Draws per overlap of the simulated registration.
        settings: All settings, as the TOML file that `twin sim --config` runs.
        status: `done`; `failed` when the scan had an error; `lost` when the worker was lost.
        stop: The stop reason in words.
        complete: Whether the planner ended the run because nothing was left to scan.
        views: Number of views.
        success: At least two views, every registration error at most epsilon, and an F-score at
            20 mm of at least ``evaluation.MIN_F_SCORE``.
        max_error: The largest registration error [m].
        coverage: Share of the coverable surface that the model covers.
        coverable_share: Share of the whole surface that is coverable.
        f10, f20, f30: F-scores at 10, 20 and 30 mm.
        accuracy, completeness: Medians [m].
        accuracy_p95, completeness_p95: Their 95 % quantiles [m].
        points: Number of points of the model.
        path, turn, duration: Journey of the robot [m, rad, s].
        plan_cpu, cpu, wall: Processor time of the planner, of the run, and its wall time [s].
        attempts: Number of attempts at the task.
        version, code, python: Versions of the software; ``code`` is a hash of its sources.
        steps: One step per view.
    """

    key: str
    variant: str
    scene: str
    seed: int
    planner: str
    preset: str
    world: str
    tour: str
    scope: str
    engine: str
    epsilon: float
    lambda_: float
    gamma: float
    sigma: float
    standoff: float
    trials: int
    settings: str
    status: Status
    stop: str
    complete: bool = False
    views: int = 0
    success: bool = False
    max_error: float | None = None
    coverage: float = 0.0
    coverable_share: float | None = None
    f10: float = 0.0
    f20: float = 0.0
    f30: float = 0.0
    accuracy: float | None = None
    accuracy_p95: float | None = None
    completeness: float | None = None
    completeness_p95: float | None = None
    points: int = 0
    path: float | None = None
    turn: float | None = None
    duration: float | None = None
    plan_cpu: float | None = None
    cpu: float | None = None
    wall: float | None = None
    attempts: int = 1
    version: str = ""
    code: str = ""
    python: str = ""
    steps: tuple[Step, ...] = ()


MAX_VIEWS = 100_000
"""Largest index of a view that is believed: a week of sweeps."""
MAX_NUMBER, MAX_COUNT = 1e15, 2**63 - 1
"""Largest numbers and counts that are believed: 30 million years in seconds, and what fits into
Parquet's integers."""
TIMING_FIELDS = ("plan_cpu", "cpu", "wall", "attempts")
"""Fields of a record and of its steps that differ between two runs of one task."""


def without_timings(record: Record) -> dict[str, Any]:
    """Return the fields that are equal in every run of the task."""
    row = {name: value for name, value in asdict(record).items() if name not in TIMING_FIELDS}
    steps = [{k: v for k, v in step.items() if k not in TIMING_FIELDS} for step in row["steps"]]
    return {**row, "steps": steps}


def to_json(record: Record) -> str:
    """Return ``record`` as one line."""
    return json.dumps(replace_nonfinite(asdict(record)), ensure_ascii=False, allow_nan=False)


def from_row(row: Mapping[str, Any]) -> Record:
    """Return the record in a row of the journal or of the Parquet file.

    Raises:
        KeyError, TypeError: The row is no record.
    """
    if not isinstance(row["steps"], (list, tuple)):
        raise TypeError("steps that are no list")
    steps = tuple(Step(**_select_known(Step, step)) for step in row["steps"])
    if any(not 0 <= step.view <= MAX_VIEWS for step in steps):
        raise TypeError(f"a view beyond {MAX_VIEWS}")
    return Record(**{**_select_known(Record, {**row, "steps": ()}), "steps": steps})


def sql_columns(cls: type = Record) -> dict[str, str]:
    """Return DuckDB's type of each field of ``cls``."""
    hints = get_type_hints(cls)
    return {field.name: _sql_type(hints[field.name]) for field in fields(cls)}


_SQL_TYPES: Mapping[Any, str] = {str: "VARCHAR", int: "BIGINT", float: "DOUBLE", bool: "BOOLEAN"}


def _sql_type(hint: Any) -> str:
    if get_origin(hint) in (Union, types.UnionType):
        (hint,) = (each for each in get_args(hint) if each is not type(None))
    if get_origin(hint) is Literal:
        return "VARCHAR"
    if get_origin(hint) is tuple:
        return _sql_type(get_args(hint)[0]) + "[]"
    if is_dataclass(hint) and isinstance(hint, type):
        inner = ", ".join(f'"{name}" {kind}' for name, kind in sql_columns(hint).items())
        return f"STRUCT({inner})"
    return _SQL_TYPES[hint]


def _select_known(cls: type, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that ``cls`` has fields for; records of a later version may have more."""
    hints = get_type_hints(cls)
    known = {name: value for name, value in row.items() if name in hints}
    for name, value in known.items():
        if not _fits(hints[name], value):
            raise TypeError(f"{name} is {value!r:.40}")
    return known


def _fits(hint: Any, value: Any) -> bool:
    """Return whether ``value`` is one of type ``hint``.

    None stands for what is not finite in optional fields; the others are always measured.
    """
    if get_origin(hint) in (Union, types.UnionType):
        return value is None or any(_fits(each, value) for each in get_args(hint))
    if get_origin(hint) is Literal:
        return isinstance(value, str) and value in get_args(hint)
    if get_origin(hint) is tuple:
        return isinstance(value, (list, tuple))
    if hint is float and type(value) in (int, float):
        return bool(-MAX_NUMBER <= value <= MAX_NUMBER)
    if hint is int and type(value) is int:
        return bool(-MAX_COUNT <= value <= MAX_COUNT)
    return bool(type(value) is hint)


def replace_nonfinite(value: Any) -> Any:
    """Return ``value`` with None for infinities and NaN, which JSON cannot express."""
    if isinstance(value, dict):
        return {name: replace_nonfinite(each) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_nonfinite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
