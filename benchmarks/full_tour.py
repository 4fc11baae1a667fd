"""Tours all round a target before and after loop closure, on the same sweeps.

``python benchmarks/full_tour.py [--scenes sine_box] [--seeds 12] [--first 0] [--jobs 1] [--json]``
digitises with the preset ``best`` without alignment, evaluates, aligns all views at once and
evaluates again. Prints a line per run on standard error, then one object {name: {value, unit, peer,
runs}}. ``error`` is that of a view relative to the one before, ``pose_error`` that of a view in the
world, given the first view's pose: RMS over the target's points.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.mapping.loop_closure import apply_alignment, solve_alignment
from scan3d_twin.core.model.evaluation import Evaluation, evaluate
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.run.resolve import scene_options
from scan3d_twin.run.settings import build_settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

EPSILON = 0.010
"""Wanted registration error [m], as in the paper."""


@dataclass(frozen=True)
class Tour:
    """One tour; lengths in m."""

    scene: str
    seed: int
    stop: str
    views: int = 0
    links: int = 0
    misfits: int = 0
    before: dict[str, float] | None = None
    after: dict[str, float] | None = None


def tour(scene: str, seed: int) -> Tour:
    """Go round the target of ``scene``."""
    loaded = load_scene(scene)
    options = [
        {**scene_options(loaded), "tour": "full"},
        preset_options("best"),
        {"alignment": {"mode": "off"}},
    ]
    config = build_settings(options).config
    with open_sim(loaded, seed) as (robot, truth):
        try:
            session = run_loop(robot, make_planner(config.planner), config, seed, Unobserved())
        except TwinError as error:
            return Tour(scene, seed, f"{type(error).__name__}: {error}")
        if len(session.views) < 2:
            return Tour(scene, seed, session.stop_reason, len(session.views))
        alignment = solve_alignment(session)
        aligned = apply_alignment(replace(session), alignment)
        before, after = (figures(evaluate(s, truth)) for s in (session, aligned))
    links, misfits = len(alignment.links), len(alignment.misfits)
    return Tour(scene, seed, session.stop_reason, len(session.views), links, misfits, before, after)


def figures(evaluation: Evaluation) -> dict[str, float]:
    """Return the figures of a model."""
    poses = np.array([pair.pose_error for pair in evaluation.pairs])
    return {
        "error": float(np.median([pair.error for pair in evaluation.pairs])),
        "worst_error": max(pair.error for pair in evaluation.pairs),
        "pose_error": float(np.sqrt(np.mean(poses**2))),
        "worst_pose_error": float(poses.max()),
        "accuracy": evaluation.accuracy.median,
        "f20": evaluation.f_score[0.020],
        "coverage": evaluation.coverage,
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["sine_box"])
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    rows: dict[str, dict[str, Any]] = {}
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for scene in arguments.scenes:
            tours = []
            for found in pool.map(tour, repeat(scene), seeds):
                print(format_tour(found), file=sys.stderr, flush=True)
                tours.append(found)
            rows.update(summary(scene, tours))
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:40s} {row['value']:10.4f} {row['unit']:6s} ({row['runs']} runs)")


def format_tour(found: Tour) -> str:
    """Return one line about a tour."""
    head = f"{found.scene} seed {found.seed}: {found.views} views, {found.stop}"
    if found.before is None or found.after is None:
        return head
    parts = [
        f"{name} {1e3 * found.before[name]:.1f} -> {1e3 * found.after[name]:.1f} mm"
        for name in ("error", "worst_error", "pose_error")
    ]
    shares = [
        f"{name} {found.before[name]:.3f} -> {found.after[name]:.3f}"
        for name in ("f20", "coverage")
    ]
    return f"{head}; {found.links} links, {found.misfits} misfits; " + ", ".join(parts + shares)


def summary(scene: str, tours: list[Tour]) -> dict[str, dict[str, Any]]:
    """Return the medians of a scene, and the share of tours whose errors all meet epsilon."""
    rows: dict[str, dict[str, Any]] = {}

    def add(name: str, value: float, unit: str, runs: int) -> None:
        rows[f"{scene}_{name}"] = {
            "value": round(value, 4), "unit": unit, "peer": "truth", "runs": runs
        }  # fmt: skip

    closed = [t.stop == "contour complete" for t in tours]
    add("closed", float(np.mean(closed)), "share", len(tours))
    done = [t for t in tours if t.before is not None and t.after is not None]
    if not done:
        return rows
    add("views", float(np.median([t.views for t in done])), "views", len(done))
    for when in ("before", "after"):
        found = [getattr(t, when) for t in done]
        good = [f["worst_error"] <= EPSILON for f in found]
        add(f"good_{when}", float(np.mean(good)), "share", len(done))
        for name in found[0]:
            length = name not in ("f20", "coverage")
            value = float(np.median([f[name] for f in found])) * (1e3 if length else 1.0)
            add(f"{name}_{when}", value, "mm" if length else "share", len(done))
    return rows


if __name__ == "__main__":
    main()
