"""The real drivers on the emulated robot against the twin itself: accuracy of whole runs.

``python benchmarks/links.py [--scene three_boxes] [--lidar urg04lx] [--links usb 115200]
[--presets paper best] [--seeds 10] [--json]``; one line per link and preset, or one object {name:
{value, unit, peer}}. Both start at the same instant, so that they see the same noise of the lidar.
A second run of the twin that starts a second later shows how much runs differ by noise alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.devices.registry import DEFAULT_LIDAR, Devices
from scan3d_twin.run.settings import Settings, build_settings, device_options
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import open_wired

LATER = 1.0
"""Delay of the second run of the twin [s]: 10 turns of the mirror."""


@dataclass(frozen=True)
class Run:
    """One closed loop; lengths in m, ``began`` in s."""

    views: int
    errors: tuple[float, ...]
    accuracy: float
    coverage: float
    began: float


def run(
    scene: str, twin: TwinConfig, config: Config, seed: int, *, wired: bool, start: float
) -> Run:
    """Digitise from ``start`` [s] on."""
    opener = open_wired if wired else open_sim
    with opener(scene, seed, twin) as (robot, truth):
        robot.clock.sleep(start - robot.clock.now())
        began = robot.clock.now()
        session = run_loop(robot, make_planner(config.planner), config, seed, Unobserved())
        found = evaluate(session, truth)
    errors = tuple(pair.error for pair in found.pairs)
    return Run(len(session.views), errors, found.accuracy.median, found.coverage, began)


def compare(scene: str, settings: Settings, seeds: int) -> dict[str, float]:
    """Return the figures of the drivers, of the twin, and of the twin a second later."""
    devices, config = settings.twin, settings.config
    drivers = [run(scene, devices, config, seed, wired=True, start=0.0) for seed in range(seeds)]
    twin, later = (
        [
            run(scene, devices, config, seed, wired=False, start=drivers[seed].began + delay)
            for seed in range(seeds)
        ]
        for delay in (0.0, LATER)
    )
    figures: dict[str, float] = {}
    for words, runs in (("drivers", drivers), ("twin", twin), ("twin later", later)):
        errors = np.concatenate([each.errors for each in runs])
        figures[f"{words}: views"] = float(np.mean([each.views for each in runs]))
        figures[f"{words}: pair error, median mm"] = 1e3 * float(np.median(errors))
        figures[f"{words}: pair error, p90 mm"] = 1e3 * float(np.quantile(errors, 0.9))
        figures[f"{words}: accuracy, median mm"] = 1e3 * float(
            np.median([each.accuracy for each in runs])
        )
        figures[f"{words}: coverage"] = float(np.mean([each.coverage for each in runs]))
    figures["drivers to twin: within one view"] = _near(drivers, twin)
    figures["twin to twin later: within one view"] = _near(twin, later)
    return figures


def _near(some: list[Run], others: list[Run]) -> float:
    """Return the share of seeds whose numbers of views differ by one at most."""
    return float(np.mean([abs(a.views - b.views) <= 1 for a, b in zip(some, others, strict=True)]))


def main() -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scene", default="three_boxes")
    parser.add_argument("--lidar", default=DEFAULT_LIDAR)
    parser.add_argument("--links", nargs="+", default=["usb", "115200"])
    parser.add_argument("--presets", nargs="+", default=["paper", "best"])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = {}
    for link in options.links:
        for name in options.presets:
            devices = Devices(lidar=options.lidar, link=link)
            stated = [device_options(devices), preset_options(name)]
            chosen = {"lidar_model": options.lidar, "lidar_link": link}
            settings = build_settings([*stated, chosen])
            for key, value in compare(options.scene, settings, options.seeds).items():
                words = f"{link}, {name}: {key}"
                results[words] = {"value": round(value, 3), "peer": "the twin without drivers"}
                if not options.json:
                    print(f"{words}: {value:.3g}", flush=True)
    if options.json:
        print(json.dumps(results, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
