"""Closed loops of presets on the twin's scenes: registration errors, views, quality of the model.

``python benchmarks/closed_loop.py [--scenes three_boxes ...] [--presets best paper] [--seeds 30]
[--first 0] [--json]``; one line per scene and preset, or one object {name: {value, unit, peer,
runs}}. ``good`` is the share of runs in which every registration error is at most epsilon.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from scan3d_twin.core.digitize import digitize
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.evaluate import evaluate
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.presets import preset
from scan3d_twin.recording.settings import settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scene import load_scene


@dataclass(frozen=True)
class Run:
    """One closed loop; lengths in m, empty where it failed."""

    scene: str
    preset: str
    seed: int
    stop: str
    views: int = 0
    errors: tuple[float, ...] = ()
    predicted: tuple[float, ...] = ()
    planned: tuple[float, ...] = ()
    overlaps: tuple[float, ...] = ()
    odometry: tuple[float, ...] = ()
    f20: float = 0.0
    coverage: float = 0.0


def run(scene: str, name: str, seed: int) -> Run:
    """Digitise ``scene`` with the preset ``name``."""
    options, trials = name.removesuffix("8"), name.endswith("8")
    extra = {"planning": {"trials": 8}} if trials else {}
    loaded = load_scene(scene)
    standoff = {} if loaded.standoff is None else {"standoff": loaded.standoff}
    own = {"tour": loaded.tour, "planning": standoff}
    config = settings([own, preset(options), extra]).config
    with open_sim(loaded, seed) as (robot, truth):
        try:
            session = digitize(robot, make_planner(config.planner), config, seed, Unobserved())
        except TwinError as error:
            return Run(scene, name, seed, f"{type(error).__name__}: {error}")
        result = evaluate(session, truth)
    made = [plan for plan in session.plans if plan.viewpoint is not None]
    placed = [view.registration for view in session.views if view.registration is not None]
    return Run(
        scene,
        name,
        seed,
        session.stop_reason,
        views=len(session.views),
        errors=tuple(pair.error for pair in result.pairs),
        predicted=tuple(registration.predicted_rmse for registration in placed),
        planned=tuple(plan.predicted_rmse for plan in made),
        overlaps=tuple(plan.overlap for plan in made),
        odometry=tuple(pair.odometry_error for pair in result.pairs),
        f20=result.f_score[0.020],
        coverage=result.coverage,
    )


def figures(runs: list[Run], epsilon: float) -> dict[str, tuple[float, str]]:
    """Return the figures of one scene and preset, each with its unit."""
    errors = np.concatenate([r.errors for r in runs])
    predicted = np.concatenate([r.predicted for r in runs])
    known = np.isfinite(predicted)
    return {
        "good": (float(np.mean([r.views > 1 and max(r.errors) <= epsilon for r in runs])), "share"),
        "views": (float(np.median([r.views for r in runs])), "views"),
        "error": (1e3 * float(np.median(errors)), "mm"),
        "error_p95": (1e3 * float(np.quantile(errors, 0.95)), "mm"),
        "above_epsilon": (float(np.mean(errors > epsilon)), "share"),
        "odometry": (1e3 * float(np.median(np.concatenate([r.odometry for r in runs]))), "mm"),
        "pred_over_true": (float(np.median(predicted[known] / errors[known])), "ratio"),
        "overlap_80": (float(np.mean(np.concatenate([r.overlaps for r in runs]) >= 0.8)), "share"),
        "f20": (float(np.median([r.f20 for r in runs])), "share"),
        "coverage": (float(np.median([r.coverage for r in runs])), "share"),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["three_boxes"])
    parser.add_argument("--presets", nargs="+", default=["best", "paper"])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    rows: dict[str, dict[str, Any]] = {}
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for scene in arguments.scenes:
            for name in arguments.presets:
                n = len(seeds)
                runs = list(pool.map(run, [scene] * n, [name] * n, seeds))
                for failed in (r for r in runs if r.views < 2):
                    print(f"{scene} {name} seed {failed.seed}: {failed.stop}", file=sys.stderr)
                done = [r for r in runs if r.views > 1]
                if not done:
                    continue
                found = figures(done, 0.010)
                for key, (value, unit) in found.items():
                    rows[f"{scene}_{name}_{key}"] = {
                        "value": round(value, 4), "unit": unit, "peer": "truth", "runs": len(done)
                    }  # fmt: skip
                line = "  ".join(f"{key} {value:.3g}" for key, (value, _) in found.items())
                print(f"{scene} {name} ({len(done)} of {n} runs): {line}", file=sys.stderr)
    if arguments.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
