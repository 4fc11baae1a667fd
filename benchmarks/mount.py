"""Extrinsic calibration of a lidar that is mounted 10 mm and 1 deg off, in the twin's living room.

``python benchmarks/mount.py [--seeds 10] [--scene living_room] [--json]`` prints one object {name:
{value, unit, peer, runs}}. Each seed is another robot of the `typical` world; it scans a full turn
and, from the same place, 300 deg to both sides, at the rate of a run. Unequal wheels tilt the robot
and move its yaw axis off the middle of the axle, so the true values are the lidar's roll relative
to the floor and its offset from the axis that the robot turned about.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scan3d_twin.core.config import Config, SweepConfig
from scan3d_twin.core.scanning.calibration.lidar_mount import (
    Calibration,
    calibrate,
    calibrate_on_panorama,
)
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.types import RangeImage
from scan3d_twin.sim.config import RobotErrorConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.truth import Truth

LATERAL, ROLL = 0.010, math.radians(1.0)
TURN, BACK = math.radians(360.0), math.radians(300.0)


@dataclass(frozen=True)
class Truly:
    """What is to be found: offset [m], roll [rad] and yaw scale."""

    lateral: float
    roll: float
    yaw_scale: float


def take(scene: str, seed: int, width: float, passes: int) -> tuple[list[RangeImage], Truly]:
    """Return sweeps from the spawn, and what is true of the first."""
    errors = replace(RobotErrorConfig(), mount_lateral=LATERAL, mount_roll=ROLL)
    config = replace(Config.preset("paper"), sweep=SweepConfig(width=width, margin=0.0))
    with open_sim(scene, seed, replace(TwinConfig(), errors=errors)) as (robot, truth):
        images = [sweep(robot, 0.0, config, lambda line: None).image]
        across, scale = turning(images[0], truth)
        images += [sweep(robot, 0.0, config, lambda line: None).image for _ in range(1, passes)]
        robot.lidar.read_line(1.0)
        return images, Truly(LATERAL + across, lean(truth), scale)


def lean(truth: Truth) -> float:
    """Return how far the lidar leans to its right now [rad]: from beams straight up."""
    evidence = truth.evidence()
    assert evidence is not None
    d = evidence.directions
    across = np.cross(d[len(d) // 4], d[len(d) // 2])
    across /= np.linalg.norm(across)
    return float(math.asin(abs(across[2])))


def turning(image: RangeImage, truth: Truth) -> tuple[float, float]:
    """Return how far left of the axis it turned about the base is [m], and the yaw scale.

    The base at p and heading theta turns about c: p = c + R(theta) a.
    """
    beam = image.spec.n_beams // 2
    lines = np.arange(0, image.n_lines, 10)
    stamps = image.stamps[lines] + image.spec.beam_times[beam]
    poses = [truth.pose_at(float(stamp)) for stamp in stamps]
    rows, right = [], []
    for pose in poses:
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        rows += [[1, 0, c, -s], [0, 1, s, c]]
        right += [pose.x, pose.y]
    a = np.linalg.lstsq(np.array(rows), np.array(right))[0]
    true = np.unwrap([pose.yaw for pose in poses])
    return float(a[3]), float(np.polyfit(image.yaws[lines, beam], true, 1)[0]) - 1.0


def run(scene: str, seed: int) -> tuple[Calibration, Truly]:
    """Return what was found and what is true."""
    turn, truly = take(scene, seed, TURN, 1)
    back, _ = take(scene, seed, BACK, 2)
    return calibrate([turn, back]), truly


def look_error(scene: str, seed: int) -> float:
    """Return by how much the yaw scale of a look around is off for the sweep after it."""
    config = replace(
        Config.preset("paper"), sweep=SweepConfig(width=math.radians(150.0), margin=0.0)
    )
    with open_sim(scene, seed) as (robot, truth):
        found = calibrate_on_panorama(take_panorama(robot, config, lambda line: None).image)
        image = sweep(robot, 0.0, config, lambda line: None).image
        assert found is not None
        return found.mount.yaw_scale - turning(image, truth)[1]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="living_room")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    errors = []
    for seed in range(arguments.seeds):
        found, true = run(arguments.scene, seed)
        m, s = found.mount, found.sigmas
        print(
            f"seed {seed}: lateral {1e3 * m.lateral:.2f} +- {1e3 * s[0]:.2f} (true "
            f"{1e3 * true.lateral:.2f}) mm, roll "
            f"{math.degrees(m.roll):.3f} +- {math.degrees(s[1]):.3f} (true "
            f"{math.degrees(true.roll):.3f}) deg, yaw scale {m.yaw_scale:.4f} +- {s[3]:.4f} (true "
            f"{true.yaw_scale:.4f})",
            file=sys.stderr,
            flush=True,
        )
        off = (m.lateral - true.lateral, m.roll - true.roll, m.yaw_scale - true.yaw_scale)
        errors.append(np.abs(off))
    lateral, roll_error, scale_error = np.array(errors).T
    looks = np.array([look_error(arguments.scene, seed) for seed in range(arguments.seeds)])
    rows: dict[str, dict[str, Any]] = {}

    def add(name: str, value: float, unit: str) -> None:
        rows[name] = {"value": round(value, 4), "unit": unit, "peer": "truth", "runs": len(errors)}

    add("mount_lateral_error", 1e3 * float(np.median(lateral)), "mm")
    add("mount_lateral_error_max", 1e3 * float(lateral.max()), "mm")
    add("mount_lateral_within_10_percent", float(np.mean(lateral <= 0.1 * LATERAL)), "share")
    add("mount_roll_error", math.degrees(float(np.median(roll_error))), "deg")
    add("mount_roll_within_10_percent", float(np.mean(roll_error <= 0.1 * ROLL)), "share")
    add("mount_yaw_scale_error", float(np.median(scale_error)), "ratio")
    add("look_yaw_scale_error", float(np.sqrt(np.mean(looks**2))), "ratio")
    add("look_yaw_scale_error_max", float(np.abs(looks).max()), "ratio")
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:40s} {row['value']:10.4f} {row['unit']:6s} ({row['runs']} runs)")


if __name__ == "__main__":
    main()
