"""``report.json``: the numbers of a run in millimetres, degrees and seconds.

``report.schema.json`` beside this file describes every field. Two runs of one seed give the same
numbers, except for ``TIMING_FIELDS``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import numpy as np

from scan3d_twin.core.model.evaluation import Distances, Evaluation
from scan3d_twin.core.model.pose_errors import PairError
from scan3d_twin.core.scanning.sphere_density import measure_density
from scan3d_twin.core.session import Session
from scan3d_twin.core.stand import STAND_REASON
from scan3d_twin.core.types import FloatArray, wrap
from scan3d_twin.run.run_warnings import find_warnings
from scan3d_twin.run.settings import Settings

Report = dict[str, Any]

TRACK_STEP = 0.03
"""Distance between the places of a track [m]: a hundredth of a picture that shows a room."""
_JUDGED = (
    "coverable_share", "coverage_20mm", "coverage_by_view", "accuracy_mm", "completeness_mm",
    "f_score",
)  # fmt: skip
"""Fields that need the truth, and are null without it."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Computing time and memory of a run.

    Attributes:
        wall_time: From opening the robot to the last view [s].
        plan_time: The planner's share of it [s].
        peak_memory: Largest memory of the process [bytes].
    """

    wall_time: float
    plan_time: float
    peak_memory: float


@dataclass(frozen=True, slots=True)
class Journey:
    """Path, turns and duration of a robot.

    Attributes:
        path: Length of the path by odometry [m].
        turn: Sum of all turns by odometry [rad].
        duration: Duration on the robot's clock [s].
        track: Where it was by odometry: time [s], x, y [m] in ``odom``, yaw [rad] (n, 4), a few
            centimetres apart; empty where that is not known.
    """

    path: float
    turn: float
    duration: float
    track: FloatArray = field(default_factory=lambda: np.zeros((0, 4)), compare=False, repr=False)


def count_views(report: Report) -> str:
    """Return the number of views in words: ``1 view``, ``2 views``."""
    return f"{report['views']} view" + ("" if report["views"] == 1 else "s")


def thin_track(track: FloatArray) -> FloatArray:
    """Return the places of ``track`` (n, 4) that are ``TRACK_STEP`` or more from the one before."""
    kept: list[int] = []
    for k in range(len(track)):
        if not kept or math.dist(track[kept[-1], 1:3], track[k, 1:3]) >= TRACK_STEP:
            kept.append(k)
    return track[kept]


def build_report(
    scene: str,
    settings: Settings,
    session: Session,
    journey: Journey,
    effort: Effort,
    points: int,
    evaluation: Evaluation | None = None,
    mesh_accuracy: Distances | None = None,
    notes: Sequence[str] = (),
) -> Report:
    """Return the report of ``session``; fields that need an ``evaluation`` are null without it.

    Its warnings begin with ``notes``.
    """
    return {
        "version": session.version,
        "scene": scene,
        "preset": settings.run.preset,
        "seed": session.seed,
        "epsilon_mm": _mm(session.config.planning.epsilon),
        "tour": session.config.tour,
        "planner": session.config.planner,
        "robot": settings.twin.robot,
        "lidar_link": settings.twin.lidar_link,
        "views": len(session.views),
        "stop_reason": session.stop_reason,
        **_quality(evaluation),
        **_registrations(session, evaluation),
        "path_m": _number(journey.path, 3),
        "turn_deg": _number(math.degrees(journey.turn), 1),
        "sim_time_s": _number(journey.duration, 3),
        "plan_time_s": _number(effort.plan_time, 3),
        "wall_time_s": _number(effort.wall_time, 3),
        "real_time_factor": _number(journey.duration / max(effort.wall_time, 1e-9), 2),
        "peak_memory_mb": _number(effort.peak_memory / 1e6, 1),
        "points": points,
        "mesh_accuracy_mm": _distances(mesh_accuracy) if mesh_accuracy else None,
        **_density(session),
        "warnings": find_warnings(session, evaluation, notes),
    }


def _density(session: Session) -> Report:
    """Return the density of the first view over the sphere, where a turntable took it."""
    if not session.views or session.views[0].observation.image.T_scan_axis is None:
        return {}
    density = measure_density(session.views[0].observation.image)
    return {
        "density": {
            "seen_share": _number(density.seen, 4),
            "low_per_deg2": _number(density.low, 2),
            "median_per_deg2": _number(density.median, 2),
            "high_per_deg2": _number(density.high, 2),
        }
    }


TIMING_FIELDS = ("wall_time_s", "plan_time_s", "real_time_factor", "peak_memory_mb")
"""The fields of a report that differ between two runs of one seed."""


def report_json(report: Report) -> str:
    """Return ``report`` as one JSON document for people and programs."""
    return json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def report_schema() -> dict[str, Any]:
    """Return the JSON schema of a report."""
    path = files("scan3d_twin.run") / "report.schema.json"
    schema: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return schema


def failure_reason(session: Session) -> str:
    """Return why ``session`` failed as a scan; an empty string when it did not.

    A scan fails when fewer than two views are registered, unless only one was wanted or can be had.
    An accuracy
    that was not expected to be met is a warning.
    """
    registered = sum(v.registration is None or v.registration.converged for v in session.views)
    needed = 1 if session.stop_reason == STAND_REASON else min(2, session.config.max_views)
    if registered < needed:
        return (
            f"{registered} of {len(session.views)} views registered, a model needs {needed}; "
            "try a smaller standoff, more views or another target"
        )
    return ""


def _quality(evaluation: Evaluation | None) -> Report:
    if evaluation is None:
        return dict.fromkeys(_JUDGED)
    return {
        "coverable_share": _number(evaluation.coverable_share, 4),
        "coverage_20mm": _number(evaluation.coverage, 4),
        "coverage_by_view": [_number(share, 4) for share in evaluation.coverage_by_view],
        "accuracy_mm": _distances(evaluation.accuracy),
        "completeness_mm": _distances(evaluation.completeness),
        "f_score": {f"{1e3 * d:.0f}": _number(f, 4) for d, f in evaluation.f_score.items()},
    }


def _distances(distances: Distances) -> Report:
    return {
        "mean": _mm(distances.mean),
        "median": _mm(distances.median),
        "p95": _mm(distances.p95),
    }


def _registrations(session: Session, evaluation: Evaluation | None) -> Report:
    pairs = {} if evaluation is None else {pair.view: pair for pair in evaluation.pairs}
    rows = [_registration(session, k, pairs.get(k)) for k in range(1, len(session.views))]
    errors = [row["error_mm"] for row in rows if row["error_mm"] is not None]
    return {"registration": rows, "max_registration_error_mm": max(errors, default=None)}


def _registration(session: Session, k: int, pair: PairError | None) -> Report:
    """Return the row of view ``k``: its plan, and the errors of its registration."""
    plan, result = session.plans[k - 1], session.views[k].registration
    moved, turned = odometry_correction(session, k)
    return {
        "view": k,
        "overlap": _number(plan.overlap, 4),
        "predicted_rmse_mm": _mm(plan.predicted_rmse),
        "error_mm": _mm(pair.error) if pair else None,
        "pose_error_mm": _mm(pair.pose_error) if pair else None,
        "odometry_error_mm": _mm(pair.odometry_error) if pair else None,
        "correction_mm": _mm(moved),
        "correction_deg": _number(math.degrees(turned), 3),
        "fitness": _number(result.fitness, 4) if result else None,
        "inlier_rmse_mm": _mm(result.inlier_rmse) if result else None,
        "converged": result is not None and result.converged,
        "fell_back": plan.fell_back,
    }


def odometry_correction(session: Session, k: int) -> tuple[float, float]:
    """Return by how much registration moved [m] and turned [rad] view ``k`` from its odometry.

    NaN where it has none.
    """
    previous, view = session.views[k - 1], session.views[k]
    if not view.observation.has_odometry:
        return math.nan, math.nan
    odometry = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    registered = previous.T_world_scan.inverse() @ view.T_world_scan
    return odometry.distance(registered), abs(wrap(registered.yaw - odometry.yaw))


def _mm(metres: float) -> float | None:
    return _number(1e3 * metres, 3)


def _number(value: float, digits: int) -> float | None:
    """Return ``value`` rounded; None where it is not finite, which JSON cannot express."""
    return round(float(value), digits) if math.isfinite(value) else None
