"""What each planner's decision costs: medians over the sessions of one closed loop, in one run.

``python benchmarks/planners.py [--scene three_boxes] [--seed 0] [--repeats 3] [--json]``; every
planner is asked about the same sessions, those of a closed loop of `fisher`, in turns, so that a
busy machine slows all of them alike. ``siicp8`` is `siicp` with 8 trials and the 90 % quantile.
One line per planner as a row of Markdown, or one object {name: {value, unit, peer, ratio, runs}}.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import digitize, unplanned
from scan3d_twin.core.evaluate import Truth
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import Planner, make_planner, planner_names
from scan3d_twin.core.presets import preset
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.recording.settings import settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scene import load_scene

PEER = "siicp8"
TWICE = ("fixed", "fixed50", "fixed80")
"""Names that cost what `fixed20` costs."""


class Keeping:
    """The planner `fisher`, which keeps every session it is asked about."""

    def __init__(self) -> None:
        self.sessions: list[Session] = []
        self._planner = make_planner("fisher")

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``."""
        plan = self._planner.plan(session, rng)
        if plan.viewpoint is not None:
            self.sessions.append(unplanned(session))
        return plan


def configuration(tour: str) -> Config:
    """Return the preset ``best`` with one trial and no calibration, as the paper's planner has."""
    return settings([{"tour": tour}, preset("best")]).config


def sessions(scene: str, seed: int) -> tuple[list[Session], Truth]:
    """Return the sessions of one closed loop, and the truth, whose world outlives the robot."""
    loaded = load_scene(scene)
    keeping = Keeping()
    with open_sim(loaded, seed) as (robot, truth):
        digitize(robot, keeping, configuration(loaded.tour), seed, Unobserved())
    return keeping.sessions, truth


def rivals(truth: Truth) -> dict[str, tuple[Planner, Callable[[Session], Session]]]:
    """Return the planners by name, each with what it changes in a session's configuration."""
    found: dict[str, tuple[Planner, Callable[[Session], Session]]] = {
        name: (make_planner(name, truth), lambda session: session)
        for name in planner_names()
        if name not in TWICE
    }
    found[PEER] = (make_planner("siicp"), eight_trials)
    return found


def eight_trials(session: Session) -> Session:
    planning = replace(session.config.planning, trials=8)
    return replace(session, config=replace(session.config, planning=planning))


def measure(scene: str, seed: int, repeats: int) -> dict[str, list[float]]:
    """Return the times of every decision [s] by planner."""
    asked, truth = sessions(scene, seed)
    planners = rivals(truth)
    times: dict[str, list[float]] = {name: [] for name in planners}
    for repeat in range(-1, repeats):
        for session in asked:
            for name, (planner, changed) in planners.items():
                ready, rng = fresh(changed(session)), np.random.default_rng([seed, repeat + 1])
                started = time.perf_counter()
                planner.plan(ready, rng)
                if repeat >= 0:  # the first round compiles and fills caches
                    times[name].append(time.perf_counter() - started)
    return times


def fresh(session: Session) -> Session:
    """Return ``session`` without what an earlier decision computed of it and left in its parts."""
    views = tuple(
        replace(
            view,
            image=replace(view.image),
            target=replace(view.target),
            observation=replace(view.observation, image=replace(view.observation.image)),
        )
        for view in session.views
    )
    return replace(session, views=views)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="three_boxes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    times = measure(options.scene, options.seed, options.repeats)
    medians = {name: float(np.median(each)) for name, each in times.items()}
    rows = {
        name: {
            "value": round(1e3 * median, 1),
            "unit": "ms",
            "peer": PEER,
            "ratio": round(medians[PEER] / median, 1),
            "runs": len(times[name]),
        }
        for name, median in sorted(medians.items(), key=lambda item: item[1])
    }
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print("| planner | a decision | times cheaper than siicp with 8 trials |\n|---|---|---|")
    for name, row in rows.items():
        print(f"| `{name}` | {row['value']:.0f} ms | {row['ratio']:.1f} |")


if __name__ == "__main__":
    main()
