"""Steps per second of the environments, by fidelity, and batched against one after the other.

A step is a move of about half a metre, a sweep of 60 deg at 5 deg/s, registration and evaluation,
in ``three_boxes`` with the grid engine on whole sweeps.

Per fidelity: the median over steps of 1 / CPU time, on one core, resets not counted. The vector
environments run ``kinematic`` on 16 random scenes and are timed by the wall, in turns, resets
counted; their figure is the ratio of the medians.

Run: ``python benchmarks/envs.py [--steps 20] [--rounds 5] [--json]``.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import gymnasium
import numpy as np

ID = "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0"
OPTIONS = {"registration": {"engine": "grid", "scope": "sweep"}}
FIFTY = 6
"""The action that takes an overlap of 50 %: steps of about half a metre."""
ENVS = 16
TARGETS = {"physics": 3.0, "lite": 8.0, "kinematic": 200.0}


def per_step(fidelity: str, steps: int) -> list[float]:
    """Return the CPU seconds of ``steps`` steps, the first one (compilation) left out."""
    env = gymnasium.make(ID, fidelity=fidelity, options=OPTIONS, goal=1.0)
    seconds: list[float] = []
    seed = 0
    while len(seconds) <= steps:
        env.reset(seed=seed)
        over = False
        while not over and len(seconds) <= steps:
            started = time.process_time()
            *_, terminated, truncated, _ = env.step(np.int64(FIFTY))
            seconds.append(time.process_time() - started)
            over = terminated or truncated
        seed += 1
    env.close()
    return seconds[1:]


def vectors(rounds: int) -> dict[str, list[float]]:
    """Return wall seconds of 4 steps of 16 environments, in turns."""
    made: dict[str, Any] = {
        "sync": gymnasium.make_vec(
            ID, ENVS, vectorization_mode="sync", fidelity="kinematic", options=OPTIONS
        ),
        "batched": gymnasium.make_vec(ID, ENVS, fidelity="kinematic", options=OPTIONS),
    }
    seconds: dict[str, list[float]] = {name: [] for name in made}
    for envs in made.values():
        envs.reset(seed=0)
        envs.step(np.full(ENVS, FIFTY))  # compiles
    for _ in range(rounds):
        for name, envs in made.items():
            started = time.perf_counter()
            for _ in range(4):
                envs.step(np.full(ENVS, FIFTY))
            seconds[name].append(time.perf_counter() - started)
    for envs in made.values():
        envs.close()
    return seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--fidelities", nargs="*", default=list(TARGETS))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows: dict[str, dict[str, Any]] = {}
    for fidelity in options.fidelities:
        rate = 1.0 / float(np.median(per_step(fidelity, options.steps)))
        rows[fidelity] = {
            "value": round(rate, 2), "unit": "steps/s of a core", "peer": TARGETS[fidelity],
            "runs": options.steps,
        }  # fmt: skip
    if options.rounds:
        seconds = vectors(options.rounds)
        ratio = float(np.median(seconds["sync"]) / np.median(seconds["batched"]))
        rows["batched"] = {
            "value": round(ratio, 2), "unit": "of SyncVectorEnv", "peer": 1.5,
            "runs": options.rounds,
        }  # fmt: skip
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:10} {row['value']:7.2f} {row['unit']} (wanted {row['peer']:g})")


if __name__ == "__main__":
    main()
