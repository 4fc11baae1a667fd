"""Fit ``planning.calibration`` and ``registration.calibration``: realised errors over predicted.

Closed loops of a preset on random scenes (``random:SEED``, seeds from 1000 on: no test, gate or
benchmark uses them) give pairs of a step's predicted error, factor left out, and the error that
registration then had. With n such ratios in ascending order, the ceil((n + 1)(1 - alpha))-th is the
factor k for which the next step's error exceeds k times its prediction with a probability of at
most alpha, whatever the ratios' distribution (split conformal prediction; Vovk, Gammerman and
Shafer 2005; Lei et al., JASA 113, 2018). A step is taken when k times the prediction meets epsilon.

The odd seeds fit the factor, the even ones measure how often it fails.

``python benchmarks/calibrate_error.py [--first 1000] [--scenes 60] [--jobs 1] [--rows FILE]
[--json]``
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from watched_loop import Watcher, run_watched

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.session import Session
from scan3d_twin.run.resolve import scene_options
from scan3d_twin.run.settings import build_settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

ALPHA_PLANNED = 0.025
"""Share of the steps whose error may exceed k times what was predicted before driving. Of runs 95 %
are to keep epsilon, and each must in all its steps: half of what is left is for what errs alike in
all steps of a run, as the range of its sensor does, the other half for single steps."""
ALPHA_REPORTED = 0.10
"""Share of the errors that may exceed k times what their registration reports."""
MOST_VIEWS = 7
"""Views of a loop: enough for a small target's tour, and no more time than needed."""


@dataclass(frozen=True)
class Step:
    """One step of a closed loop; lengths in m.

    Attributes:
        seed: Of scene and run.
        view: Index of the view it led to.
        overlap: Chosen.
        predicted: Planner's prediction without the factor; NaN or infinite where it has none.
        reported: By the registration itself.
        error: That it had.
        odometry: That odometry had.
    """

    seed: int
    view: int
    overlap: float
    predicted: float
    reported: float
    error: float
    odometry: float


def steps(seed: int, name: str, factor: float | None) -> list[Step]:
    """Return the steps of a closed loop on the random scene ``seed``; none if it failed early."""
    scene, watcher = load_scene(f"random:{seed}"), Watcher()
    own = {**scene_options(scene), "max_views": MOST_VIEWS}
    extra = {"alignment": {"mode": "off"}}
    if factor is not None:
        extra["planning"] = {"calibration": factor}
    config = build_settings([preset_options(name), own, extra]).config
    with open_sim(scene, seed) as (robot, truth):
        session = run_watched(f"random:{seed}", robot, config, seed, watcher)
        if session is None:
            return []
        pairs = evaluate(session, truth).pairs
    return [_step(session, seed, pair) for pair in pairs]


def _step(session: Session, seed: int, pair: Any) -> Step:
    plan, view = session.plans[pair.view - 1], session.views[pair.view]
    reported = math.nan if view.registration is None else view.registration.predicted_rmse
    predicted = plan.predicted_rmse / session.config.planning.calibration
    return Step(seed, pair.view, plan.overlap, predicted, reported, pair.error, pair.odometry_error)


def conformal(ratios: Iterable[float], alpha: float) -> float:
    """Return the factor that the next ratio exceeds with a probability of at most ``alpha``."""
    ordered = sorted(ratios)
    rank = math.ceil((len(ordered) + 1) * (1.0 - alpha))
    return ordered[rank - 1] if rank <= len(ordered) else math.inf


def fit(found: list[Step], epsilon: float) -> dict[str, dict[str, Any]]:
    """Return the factor from the odd seeds and what it is worth on the even ones."""
    known = [s for s in found if math.isfinite(s.predicted) and s.predicted > 0]
    registered = [s for s in found if math.isfinite(s.reported) and s.reported > 0]
    odd, even = ([s for s in known if s.seed % 2 == k] for k in (1, 0))
    factor = conformal((s.error / s.predicted for s in odd), ALPHA_PLANNED)
    whole = conformal((s.error / s.predicted for s in known), ALPHA_PLANNED)
    rows = {
        "calibration": (factor, "ratio", len(odd)),
        "all_seeds": (whole, "ratio", len(known)),
        "exceeded": (_share(s.error > factor * s.predicted for s in even), "share", len(even)),
        "registration_calibration": (
            conformal((s.error / s.reported for s in registered if s.seed % 2), ALPHA_REPORTED),
            "ratio", sum(s.seed % 2 for s in registered),
        ),
        "registration_all_seeds": (
            conformal((s.error / s.reported for s in registered), ALPHA_REPORTED),
            "ratio", len(registered),
        ),
        "above_epsilon": (_share(s.error > epsilon for s in known), "share", len(known)),
        "pred_over_true": (
            float(np.median([s.predicted / s.error for s in known])), "ratio", len(known),
        ),
        "reported_over_true": (
            float(np.nanmedian([s.reported / s.error for s in known])), "ratio", len(known),
        ),
    }  # fmt: skip
    return {
        name: {"value": round(value, 4), "unit": unit, "peer": "truth", "runs": runs}
        for name, (value, unit, runs) in rows.items()
    }


def _share(flags: Iterable[bool]) -> float:
    return float(np.mean(list(flags) or [math.nan]))


def _write(path: Path, found: list[Step]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Step)])
        writer.writeheader()
        writer.writerows(asdict(step) for step in found)


def main() -> None:
    """Run, fit and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="best")
    parser.add_argument("--factor", type=float, help="run with this factor; the preset's if not")
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="write all steps to this CSV file")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.first < 1000:
        parser.error("seeds below 1000 are for tests, gates and benchmarks")
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    found: list[Step] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        run = partial(steps, name=arguments.preset, factor=arguments.factor)
        for seed, made in zip(seeds, pool.map(run, seeds), strict=True):
            found += made
            print(f"random:{seed}: {len(made)} steps", file=sys.stderr)
            if arguments.rows:
                _write(arguments.rows, found)
    rows = fit(found, build_settings([]).config.planning.epsilon)
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:20s} {row['value']:8.3f} {row['unit']:6s} ({row['runs']} steps)")


if __name__ == "__main__":
    main()
