"""Steps per second of the environments, by fidelity, and batched against one after the other.

A step is a move of about half a metre, a sweep of 60 deg at 5 deg/s, registration and evaluation,
in ``three_boxes`` with the grid engine on whole sweeps.

Per fidelity: median over the steps of 1 / CPU time, on one core, without resets. The vector
environments run ``kinematic`` in 16 such scenes, in turns, by wall time with resets; their figure
is the ratio of the medians.

``--against`` compares with another checkout of this repository that has its own ``.venv``: the
ratio of steps per second, each the median over blocks in turns. The other checkout runs this file.

Run: ``python benchmarks/envs.py [--steps 20] [--rounds 5] [--against FOLDER] [--json]``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

ID = "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0"
OPTIONS = {"registration": {"engine": "grid", "scope": "sweep"}}
KINEMATIC: dict[str, Any] = {"fidelity": "kinematic", "preset": "paper", "options": OPTIONS}
FIFTY = 6
"""The action that takes an overlap of 50 %: steps of about half a metre."""
ENVS = 16
TARGETS = {"physics": 3.0, "lite": 8.0, "kinematic": 200.0}
TIMES = {"physics": 1.5, "lite": 2.0, "kinematic": 3.5}
"""Steps per second that are wanted, in those of another build."""
Row = dict[str, float | str]


def per_step(fidelity: str, steps: int) -> list[float]:
    """Return the CPU seconds of ``steps`` steps, the first one (compilation) left out."""
    env = gymnasium.make(ID, fidelity=fidelity, preset="paper", options=OPTIONS, goal=1.0)
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
        "sync": gymnasium.make_vec(ID, ENVS, vectorization_mode="sync", **KINEMATIC),
        "batched": gymnasium.make_vec(ID, ENVS, **KINEMATIC),
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


def rate(fidelity: str, steps: int) -> Row:
    """Return the steps per second of ``fidelity`` and what is wanted of it."""
    value = 1.0 / float(np.median(per_step(fidelity, steps)))
    return _row(value, "steps/s of a core", TARGETS[fidelity], steps)


def batched(rounds: int) -> Row:
    """Return how many times as fast as one after the other the batched environments are."""
    seconds = vectors(rounds)
    ratio = float(np.median(seconds["sync"]) / np.median(seconds["batched"]))
    return _row(ratio, "of SyncVectorEnv", 1.5, rounds)


def against(folder: Path, fidelity: str, steps: int, blocks: int) -> Row:
    """Return how many times as fast as the build in ``folder`` this one is."""
    folder = folder.resolve()
    pythons = {"own": sys.executable, "other": str(folder / ".venv" / "bin" / "python")}
    rates: dict[str, list[float]] = {name: [] for name in pythons}
    for _ in range(blocks):
        for name, python in pythons.items():
            rates[name].append(_measured(python, fidelity, steps))
    ratio = float(np.median(rates["own"]) / np.median(rates["other"]))
    return _row(ratio, f"of {folder.name}", TIMES[fidelity], blocks)


def _measured(python: str, fidelity: str, steps: int) -> float:
    """Return the steps per second that ``python`` measures with this file."""
    given = ["--fidelities", fidelity, "--steps", str(steps), "--rounds", "0", "--json"]
    command = [python, str(Path(__file__).resolve()), *given]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(json.loads(done.stdout)[fidelity]["value"])


def _row(value: float, unit: str, wanted: float, runs: int) -> Row:
    return {"value": round(value, 2), "unit": unit, "peer": wanted, "runs": runs}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=5, help="of the vectors, 0 for none")
    parser.add_argument("--fidelities", nargs="*", default=list(TARGETS))
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another build, instead")
    parser.add_argument("--blocks", type=int, default=5, help="of each build, in turns")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    rows: dict[str, Row] = {}
    for fidelity in options.fidelities:
        if options.against is None:
            rows[fidelity] = rate(fidelity, options.steps)
        else:
            compared = against(options.against, fidelity, options.steps, options.blocks)
            rows[f"{fidelity}_vs"] = compared
    if options.rounds and options.against is None:
        rows["batched"] = batched(options.rounds)

    if options.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:12} {row['value']:7.2f} {row['unit']} (wanted {row['peer']:g})")


if __name__ == "__main__":
    main()
