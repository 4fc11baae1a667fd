"""Replays registration and planning, the pure half of a run, on recorded sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import ask_planner, integrate
from scan3d_twin.core.mapping.loop_closure import align_final
from scan3d_twin.core.planning import Planner
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.session_start import tune_config
from scan3d_twin.core.types import Plan, Pose2, wrap
from scan3d_twin.recording.exact_json import are_equal

Row = dict[str, Any]
STOPPED = "stopped by the user"


def replay(
    session: Session, config: Config, planner: Planner, step: Callable[[int], None]
) -> Session:
    """Return the session that the sweeps of ``session`` give with ``config`` and ``planner``.

    Viewpoints and target stay as recorded: new plans are made, but not carried out. Views without
    odometry, which a person has placed, are only registered.

    Args:
        session: A run before its end; its panoramas serve the plans that need one.
        config: The options of the replay.
        planner: Plans after each view.
        step: Called with the index of each finished view.
    """
    first = tuple(look for look in session.panoramas if look[0] == 0)
    config = tune_config(session, config)
    again = replace(session, config=config, panoramas=first, views=(), plans=(), misfits=())
    for k, view in enumerate(session.views):
        again = integrate(again, view.observation)
        if k < len(session.plans) and not _is_placed_by_hand(session, k + 1):
            again = _plan_again(again, session, planner)
        step(k)
    return again


def _is_placed_by_hand(session: Session, k: int) -> bool:
    """Return whether there is a view ``k``, and a person chose its place."""
    return k < len(session.views) and not session.views[k].observation.has_odometry


def _plan_again(again: Session, session: Session, planner: Planner) -> Session:
    plan = ask_planner(planner, again)
    looks = [look for taken, look in session.panoramas if taken == len(again.views)]
    if plan.needs_panorama and looks:
        again = again.with_panorama(looks[0])
        plan = ask_planner(planner, again)
    return again.with_plan(plan)


def finish_replay(again: Session, recorded: Session) -> Session:
    """Return the replayed session, with the final alignment if the ``recorded`` one had it."""
    reasons = {STOPPED, *(plan.reason for plan in recorded.plans[-1:])}
    return align_final(again) if recorded.stop_reason in reasons else again


def compare_sessions(recorded: Session, again: Session) -> list[Row]:
    """Return a row per view: differences of pose, registration and plan [mm, deg].

    The plan of a view is the one that led to it; the first view has none.
    """
    rows = []
    for k, (before, now) in enumerate(zip(recorded.views, again.views, strict=True)):
        # Take the plans that led here
        plans = [each.plans[k - 1] if k else None for each in (recorded, again)]

        # Compare pose, registration and plan
        row = {
            "view": k,
            "identical": are_equal((before, plans[0]), (now, plans[1])),
            "moved_mm": _mm(before.T_world_scan.distance(now.T_world_scan)),
            "turned_deg": _turned(before.T_world_scan, now.T_world_scan),
            "recorded": {**_registration(before), **_plan(plans[0])},
            "replayed": {**_registration(now), **_plan(plans[1])},
        }
        rows.append(row)
    return rows


def compare_last_plans(recorded: Session, again: Session) -> Row | None:
    """Return what was planned after the last view, then and now; None if nothing was recorded."""
    if len(recorded.plans) < len(recorded.views) or not recorded.plans:
        return None
    before, now = recorded.plans[-1], again.plans[-1]
    return {
        "identical": are_equal(before, now),
        "recorded": {**_plan(before), "reason": before.reason},
        "replayed": {**_plan(now), "reason": now.reason},
    }


def _registration(view: View) -> Row:
    result = view.registration
    return {
        "target_points": len(view.target),
        "converged": None if result is None else result.converged,
        "inlier_rmse_mm": None if result is None else _mm(result.inlier_rmse),
    }


def _plan(plan: Plan | None) -> Row:
    if plan is None:
        return {"overlap": None, "predicted_rmse_mm": None, "viewpoint": None}
    where = plan.viewpoint
    return {
        "overlap": round(plan.overlap, 4),
        "predicted_rmse_mm": _mm(plan.predicted_rmse),
        "viewpoint": where and [round(where.x, 3), round(where.y, 3), round(where.yaw, 4)],
    }


def _turned(before: Pose2, now: Pose2) -> float:
    return round(abs(math.degrees(wrap(now.yaw - before.yaw))), 3)


def _mm(metres: float) -> float | None:
    return round(1e3 * metres, 3) if math.isfinite(metres) else None
