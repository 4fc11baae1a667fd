"""Cost of each planner's decision: medians over the sessions of one closed loop, in one run.

``python benchmarks/planners.py [--scene three_boxes] [--seed 0] [--repeats 3] [--steps 20]
[--json]``. All planners plan for the same sessions, those of a closed loop of `fisher`, in turns;
processor time is measured, so that a busy machine slows none of them. ``siicp8`` is `siicp` with 8
trials and the 90 % quantile, ``fisher`` the closed form alone, ``fisher+checks`` with the simulated
registrations of `best`. ``place`` only places the viewpoint, as every planner does that chooses an
overlap; ratios are of the times less that. Prints a Markdown row per planner, or one object {name:
{value, unit, peer, ratio, runs}}.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.digitize import drop_latest_plan, run_loop
from scan3d_twin.core.mapping.scan_matching import keep_surfels
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import Planner, list_planners, make_planner
from scan3d_twin.core.planning.context import PlanningContext, stop_plan
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.run.settings import build_settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

PEER, SHARED = "siicp8", "place"
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
            self.sessions.append(drop_latest_plan(session))
        return plan


def configuration(tour: str) -> Config:
    """Return the configuration of the preset ``best``."""
    return build_settings([{"tour": tour}, preset_options("best")]).config


def sessions(scene: str, seed: int) -> tuple[list[Session], Truth]:
    """Return the sessions of one closed loop, and the truth, whose world outlives the robot."""
    loaded = load_scene(scene)
    keeping = Keeping()
    with open_sim(loaded, seed) as (robot, truth):
        run_loop(robot, keeping, configuration(loaded.tour), seed, Unobserved())
    return keeping.sessions, truth


def rivals(truth: Truth) -> dict[str, tuple[Planner, Callable[[Session], Session]]]:
    """Return the planners by name, each with what it changes in a session's configuration."""
    found: dict[str, tuple[Planner, Callable[[Session], Session]]] = {
        name: (make_planner(name, truth), lambda session: session)
        for name in list_planners()
        if name not in TWICE
    }
    found[PEER] = (make_planner("siicp"), with_planning(trials=8, quantile=0.9))
    found["fisher+checks"] = found["fisher"]
    found["fisher"] = (make_planner("fisher"), with_planning(checks=0))
    found[SHARED] = (Placing(), lambda session: session)
    return found


class Placing:
    """Does what every planner does that chooses an overlap, and decides nothing."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``."""
        context = PlanningContext(session)
        return stop_plan(context.termination_reason() or str(context.find_placement(0.2)))


def with_planning(**changes: object) -> Callable[[Session], Session]:
    """Return what changes options of ``[planning]`` in a session's configuration."""

    def changed(session: Session) -> Session:
        planning = replace(session.config.planning, **changes)  # type: ignore[arg-type]
        return replace(session, config=replace(session.config, planning=planning))

    return changed


def measure(scene: str, seed: int, repeats: int, steps: int) -> dict[str, list[float]]:
    """Return the times of every decision [s] by planner."""
    asked, truth = sessions(scene, seed)
    asked = asked[:steps]
    planners = rivals(truth)
    times: dict[str, list[float]] = {name: [] for name in planners}
    for repeat in range(-1, repeats):
        for session in asked:
            for name, (planner, changed) in planners.items():
                ready, rng = fresh(changed(session)), np.random.default_rng([seed, repeat + 1])
                started = time.process_time()
                planner.plan(ready, rng)
                if repeat >= 0:  # the first round compiles and fills caches
                    times[name].append(time.process_time() - started)
    return times


def fresh(session: Session) -> Session:
    """Return ``session`` with its latest view as a planner finds it, nothing computed yet.

    What earlier decisions left in the earlier views is there in a closed loop as well, and so are
    the surfels of a latest view that was registered.
    """
    view = session.views[-1]
    latest = replace(
        view,
        image=replace(view.image),
        target=replace(view.target),
        observation=replace(view.observation, image=replace(view.observation.image)),
    )
    if len(session.views) > 1:
        keep_surfels(latest, session.config, session.workspace)
    return replace(session, views=(*session.views[:-1], latest))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="three_boxes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--steps", type=int, default=20, help="largest number of sessions")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    times = measure(options.scene, options.seed, options.repeats, options.steps)
    shared = float(np.median(times[SHARED]))
    medians = {name: float(np.median(each)) for name, each in times.items()}
    rows = {
        name: {
            "value": round(1e3 * median, 1),
            "unit": "ms",
            "peer": PEER,
            "ratio": round((medians[PEER] - shared) / max(median - shared, 1e-4), 1),
            "runs": len(times[name]),
        }
        for name, median in sorted(medians.items(), key=lambda item: item[1])
    }
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print("| planner | a decision | times cheaper than siicp8, without place |\n|---|---|---|")
    for name, row in rows.items():
        print(f"| `{name}` | {row['value']:.0f} ms | {row['ratio']:.1f} |")


if __name__ == "__main__":
    main()
