"""The paper's claims on the twin: step lengths, overlaps and errors of whole runs.

Does one closed-loop run with ``--preset paper`` per scene and seed. Claims: a surface with features
allows longer steps than a bare wall (sections 5 and 6), and if no overlap meets epsilon the robot
falls back to 80 %. Run: ``python benchmarks/paper.py [--seeds 20] [--json]``; with
``--planning trials=8 quantile=0.9`` or ``--registration border=keep`` for other settings.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

SCENES = ("three_boxes", "sine_box", "plain_wall", "shiny_cylinder")
BOOTSTRAP = 2000


@dataclass(frozen=True)
class Run:
    """Headline figures of one run; lengths in m."""

    scene: str
    seed: int
    stop: str
    views: int = 0
    steps: tuple[float, ...] = ()
    overlaps: tuple[float, ...] = ()
    fallbacks: tuple[bool, ...] = ()
    errors: tuple[float, ...] = ()
    odometry: tuple[float, ...] = ()
    registered: int = 0
    coverage: float = 0.0
    accuracy: float = float("nan")
    f20: float = 0.0
    sim_time: float = 0.0


def run(scene: str, seed: int, base: Config) -> Run:
    """Digitise ``scene`` once; a run that fails says why in ``stop``."""
    loaded = load_scene(scene)
    config = dataclasses.replace(base, tour=loaded.tour)
    with open_sim(loaded, seed) as (robot, truth):
        try:
            session = run_loop(robot, make_planner("siicp"), config, seed, Unobserved())
        except TwinError as error:
            return Run(scene, seed, f"{type(error).__name__}: {error}")
        result = evaluate(session, truth)
        sim_time = robot.clock.now()
    places = [view.T_world_scan for view in session.views]
    made = [plan for plan in session.plans if plan.viewpoint is not None]
    return Run(
        scene,
        seed,
        session.stop_reason,
        views=len(session.views),
        steps=tuple(a.distance(b) for a, b in pairwise(places)),
        overlaps=tuple(plan.overlap for plan in made),
        fallbacks=tuple(plan.fell_back for plan in made),
        errors=tuple(pair.error for pair in result.pairs),
        odometry=tuple(pair.odometry_error for pair in result.pairs),
        registered=sum(bool(v.registration and v.registration.converged) for v in session.views),
        coverage=result.coverage,
        accuracy=result.accuracy.median,
        f20=result.f_score[0.020],
        sim_time=sim_time,
    )


def median_difference(a: list[Run], b: list[Run]) -> tuple[float, float, float]:
    """Return the difference of the median steps and its bootstrap 95 % interval over runs [m]."""
    rng = np.random.default_rng(0)

    def median(runs: list[Run]) -> float:
        return float(np.median([step for run in runs for step in run.steps]))

    draws = [
        median([a[i] for i in rng.integers(len(a), size=len(a))])
        - median([b[i] for i in rng.integers(len(b), size=len(b))])
        for _ in range(BOOTSTRAP)
    ]
    low, high = np.quantile(draws, [0.025, 0.975])
    return median(a) - median(b), float(low), float(high)


def flat(runs: list[Run], name: str) -> np.ndarray:
    """Return the values of a per-step field over all runs."""
    return np.array([value for run in runs for value in getattr(run, name)])


def changed(section: Any, settings: list[str]) -> Any:
    """Return a section of the configuration with ``FIELD=VALUE`` settings applied."""
    pairs = [setting.split("=", 1) for setting in settings]
    values = {name: type(getattr(section, name))(value) for name, value in pairs}
    return dataclasses.replace(section, **values)


def table(by_scene: dict[str, list[Run]]) -> None:
    """Print a line per scene: medians over runs or steps, and shares of the steps."""
    columns = ("done", "views", "step m", "eta>=.7", "80 %", "error mm", "p95", "<=10", "odometry")
    columns += ("coverage", "accuracy", "F@20")
    print(f"{'':15}" + "".join(f"{column:>10}" for column in columns))
    for scene, runs in by_scene.items():
        done = [run for run in runs if run.views > 1]
        errors = 1e3 * flat(done, "errors")
        cells = (
            f"{len(done)}/{len(runs)}",
            f"{np.median([run.views for run in done]):.0f}",
            f"{np.median(flat(done, 'steps')):.2f}",
            f"{np.mean(flat(done, 'overlaps') > 0.69):.2f}",
            f"{np.mean(flat(done, 'fallbacks')):.2f}",
            f"{np.median(errors):.1f}",
            f"{np.quantile(errors, 0.95):.1f}",
            f"{np.mean(errors <= 10):.2f}",
            f"{1e3 * np.median(flat(done, 'odometry')):.1f}",
            f"{np.median([run.coverage for run in done]):.2f}",
            f"{1e3 * np.median([run.accuracy for run in done]):.1f}",
            f"{np.median([run.f20 for run in done]):.2f}",
        )
        print(f"{scene:15}" + "".join(f"{cell:>10}" for cell in cells))
        for run in runs:
            if run.views < 2:
                print(f"    seed {run.seed}: {run.stop}")


def main() -> None:
    """Run all scenes and seeds and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--planning", nargs="*", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--registration", nargs="*", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    config = dataclasses.replace(
        Config.preset("paper"),
        planning=changed(Config.preset("paper").planning, options.planning),
        registration=changed(Config.preset("paper").registration, options.registration),
    )
    tasks = [(scene, seed) for scene in options.scenes for seed in range(options.seeds)]
    with ProcessPoolExecutor(options.jobs) as pool:
        futures = [pool.submit(run, scene, seed, config) for scene, seed in tasks]
        runs = [future.result() for future in futures]
    by_scene = {scene: [r for r in runs if r.scene == scene] for scene in options.scenes}
    rows = {}
    for scene in ("three_boxes", "sine_box"):
        if scene in by_scene and "plain_wall" in by_scene:
            value, low, high = median_difference(by_scene[scene], by_scene["plain_wall"])
            rows[f"step_{scene}_minus_wall"] = {
                "value": value,
                "unit": "m",
                "peer": "plain_wall",
                "runs": options.seeds,
                "interval": [low, high],
            }
    for scene, some in by_scene.items():
        rows[f"fallback_{scene}"] = {
            "value": float(np.mean(flat(some, "fallbacks"))),
            "unit": "share of steps",
            "peer": None,
            "runs": options.seeds,
        }
    if options.json:
        print(json.dumps(rows))
        return
    table(by_scene)
    for name, row in rows.items():
        interval = row.get("interval")
        print(
            f"{name}: {row['value']:.3f} {row['unit']}"
            + (f", 95 %: {interval}" if interval else "")
        )


if __name__ == "__main__":
    main()
