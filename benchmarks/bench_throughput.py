"""Utilisation of the workers of a local bench: ``python benchmarks/bench_throughput.py [--json]``.

Runs ``--seeds`` x 2 short loops (shiny_cylinder, three_boxes) on ``--jobs`` workers and reports

* ``in_tasks``: share of the workers' time inside runs, from the start of the first run to the end
  of the last; it does not depend on other load;
* ``processor``: processor time of the runs over that of all processors, start and end included; it
  is meaningful only on an idle computer.
"""

from __future__ import annotations

import argparse
import json
import time

from scan3d_twin.bench.engine import run_on_workers
from scan3d_twin.bench.local import local_engine
from scan3d_twin.bench.spec import list_tasks, make_experiment


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    experiment = make_experiment(["shiny_cylinder", "three_boxes"], [], ["best"])
    chosen = list_tasks(experiment.with_options({"max_views": 2}).with_seeds(arguments.seeds, 0))
    ends: list[tuple[float, float]] = []
    processor, started = 0.0, time.perf_counter()
    with local_engine(arguments.jobs, 600.0) as engine:
        for done in run_on_workers(chosen, engine):
            ends.append((time.perf_counter(), done.record.wall or 0.0))
            processor += done.record.cpu or 0.0
    whole = time.perf_counter() - started
    begin = min(end - wall for end, wall in ends)
    # The last runs end one by one: until the first worker finds nothing left, none may wait.
    full = sorted(end for end, _ in ends)[-arguments.jobs]
    inside = sum(max(0.0, min(end, full) - max(end - wall, begin)) for end, wall in ends)
    rows = {
        "in_tasks": (inside / (arguments.jobs * (full - begin)), "share"),
        "processor": (processor / (arguments.jobs * whole), "share"),
        "runs": (float(len(ends)), "runs"),
        "start": (begin - started, "s"),
        "runs_per_minute": (60 * len(ends) / whole, "1/min"),
    }
    if arguments.json:
        table = {
            name: {"value": round(value, 4), "unit": unit, "peer": "ideal", "runs": len(ends)}
            for name, (value, unit) in rows.items()
        }
        print(json.dumps(table, indent=1))
        return
    for name, (value, unit) in rows.items():
        print(f"{name:16} {value:8.3f} {unit}")


if __name__ == "__main__":
    main()
