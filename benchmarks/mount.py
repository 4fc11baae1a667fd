"""Calibration of a lidar that is mounted 10 mm and 1 deg wrong in the twin's living room.

``python benchmarks/mount.py [--seeds 10] [--scene living_room] [--json]`` prints one object {name:
{value, unit, peer, runs}}. Each seed is another robot of the `typical` world; it scans a full turn
and, from the same place, 300 deg to both sides, at the rate of a run. Different wheels lean
it: the true roll is that of the lidar to the floor.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from scan3d_twin.core.config import Config, SweepConfig
from scan3d_twin.core.self_calibration import Calibration, calibrate
from scan3d_twin.core.sweep import sweep
from scan3d_twin.core.types import RangeImage
from scan3d_twin.sim.config import RobotErrorConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.truth import Truth

LATERAL, ROLL = 0.010, math.radians(1.0)
TURN, BACK = math.radians(360.0), math.radians(300.0)


def take(scene: str, seed: int, width: float, passes: int) -> tuple[list[RangeImage], float, float]:
    """Return sweeps from the spawn, the robot's lean to its right [rad] and its true yaw scale."""
    errors = replace(RobotErrorConfig(), mount_lateral=LATERAL, mount_roll=ROLL)
    config = replace(Config(), sweep=SweepConfig(width=width))
    with open_sim(scene, seed, replace(TwinConfig(), errors=errors)) as (robot, truth):
        images = [sweep(robot, 0.0, config, lambda line: None).image for _ in range(passes)]
        robot.lidar.read_line(1.0)
        return images, lean(truth), yaw_scale(images[0], truth)


def lean(truth: Truth) -> float:
    """Return how far the lidar leans to its right now [rad]: from beams straight up."""
    evidence = truth.evidence()
    assert evidence is not None
    d = evidence.directions
    across = np.cross(d[len(d) // 4], d[len(d) // 2])
    across /= np.linalg.norm(across)
    return float(math.asin(abs(across[2])))


def yaw_scale(image: RangeImage, truth: Truth) -> float:
    """Return by which share more the robot turned in ``image`` than its odometry told."""
    beam = image.spec.n_beams // 2
    lines = np.arange(0, image.n_lines, 10)
    stamps = image.stamps[lines] + image.spec.beam_times[beam]
    true = np.unwrap([truth.pose_at(float(stamp)).yaw for stamp in stamps])
    return float(np.polyfit(image.yaws[lines, beam], true, 1)[0]) - 1.0


def run(scene: str, seed: int) -> tuple[Calibration, float, float]:
    """Return what was found, the true roll [rad] and the true yaw scale."""
    turn, roll, scale = take(scene, seed, TURN, 1)
    back, _, _ = take(scene, seed, BACK, 2)
    return calibrate([turn, back]), roll, scale


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="living_room")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    errors = []
    for seed in range(arguments.seeds):
        found, roll, scale = run(arguments.scene, seed)
        m, s = found.mount, found.sigmas
        print(
            f"seed {seed}: lateral {1e3 * m.lateral:.2f} +- {1e3 * s[0]:.2f} mm, roll "
            f"{math.degrees(m.roll):.3f} +- {math.degrees(s[1]):.3f} (true "
            f"{math.degrees(roll):.3f}) deg, yaw scale {m.yaw_scale:.4f} +- {s[3]:.4f} (true "
            f"{scale:.4f})",
            file=sys.stderr,
            flush=True,
        )
        errors.append((abs(m.lateral - LATERAL), abs(m.roll - roll), abs(m.yaw_scale - scale)))
    lateral, roll_error, scale_error = np.array(errors).T
    rows: dict[str, dict[str, Any]] = {}

    def add(name: str, value: float, unit: str) -> None:
        rows[name] = {"value": round(value, 4), "unit": unit, "peer": "truth", "runs": len(errors)}

    add("mount_lateral_error", 1e3 * float(np.median(lateral)), "mm")
    add("mount_lateral_error_max", 1e3 * float(lateral.max()), "mm")
    add("mount_lateral_within_10_percent", float(np.mean(lateral <= 0.1 * LATERAL)), "share")
    add("mount_roll_error", math.degrees(float(np.median(roll_error))), "deg")
    add("mount_roll_within_10_percent", float(np.mean(roll_error <= 0.1 * ROLL)), "share")
    add("mount_yaw_scale_error", float(np.median(scale_error)), "ratio")
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:40s} {row['value']:10.4f} {row['unit']:6s} ({row['runs']} runs)")


if __name__ == "__main__":
    main()
