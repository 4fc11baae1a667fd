"""Calibration of ten robots for each pattern: lever, tilt, play and lean, from scans alone.

``python benchmarks/turntable_calibration.py [--pattern yaw] [--seeds 10] [--json]``
prints the table of docs/patterns.md: of how many robots each is found. Each seed from 1000 on draws
another robot in living_room: the lidar 5 to 20 mm off to a side, turned by 0.5 to 2 degrees about
each of its axes, the axis of the turntable leaning by as much, and a play of 0.4 to 1.8 times the
nominal one. It scans as the documentation says: both ways at 5 and at 15 deg/s; with ``yaw-base``,
a full turn, and 300 degrees both ways.

Found is a lever within 1 mm or 10 %, a tilt or lean within 10 % (or 0.05 degrees, 10 % of the
least that is drawn, as sums of two may vanish), and a play within 20 %.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, replace

import mount
import numpy as np

from scan3d_twin.core.config import PATTERNS, Config, SweepConfig
from scan3d_twin.core.scanning.calibration.lidar_mount import Calibration, calibrate
from scan3d_twin.core.scanning.patterns import LEVER
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import RangeImage
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.truth import Truth
from scan3d_twin.sim.turntable.turntable import SimTurntable

FIRST_SEED = 1000
SLOW, FAST, BASE_RATE = math.radians(5.0), math.radians(15.0), math.radians(5.5)
LEVER_LIMIT, TILT_LIMIT = 0.001, math.radians(0.05)
ERRORS_STREAM = 77
"""Of the one seed: the errors of the robot."""
KINDS = ("lever", "tilt", "play", "axis")


@dataclass(frozen=True)
class Taken:
    """The sweeps of one robot by place, and what is to be found, by the names of ``MountConfig``.

    Attributes:
        places: The sweeps.
        true: What is to be found.
        nominal_play: Play that its driver takes off [rad].
    """

    places: list[list[RangeImage]]
    true: dict[str, float]
    nominal_play: float = 0.0


def draw_errors(seed: int) -> dict[str, float]:
    """Return the errors of one robot, by the names of ``RobotErrorConfig``."""
    rng = np.random.default_rng([seed, ERRORS_STREAM])

    def draw(low: float, high: float) -> float:
        return float(rng.choice([-1, 1])) * float(rng.uniform(low, high))

    turns = ("mount_roll", "mount_pitch", "mount_yaw", "axis_roll", "axis_pitch")
    errors = {"mount_lateral": draw(0.005, 0.02)}
    errors |= {name: math.radians(draw(0.5, 2.0)) for name in turns}
    return errors | {"table_play": float(rng.uniform(0.4, 1.8))}


def find_true(pattern: str, errors: dict[str, float], play: float) -> dict[str, float]:
    """Return what planes and floor show of ``errors`` of a robot with a turntable.

    A turn of the lidar about the axis itself shows as one of the axis, and the lever is that across
    the plane as it is turned.
    """
    true = {name: errors[f"mount_{name}"] for name in ("lateral", "roll", "pitch")}
    if pattern != "roll":
        c, s = math.cos(errors["mount_yaw"]), math.sin(errors["mount_yaw"])
        true["lateral"] = c * errors["mount_lateral"] - s * LEVER
    true |= {"play": play, "axis_roll": errors["axis_roll"], "axis_pitch": errors["axis_pitch"]}
    if pattern == "pitch":
        true["axis_pitch"] += errors["mount_yaw"]
    if pattern == "roll":
        true["axis_roll"] += true.pop("roll")
        true["yaw"] = errors["mount_yaw"]
    return true


def take_by_table(pattern: str, seed: int) -> Taken:
    """Return the sweeps of a stand with a turntable, both ways at two rates."""
    twin, errors = replace(TwinConfig(), robot="stand", pattern=pattern), draw_errors(seed)
    twin = replace(twin, errors=replace(twin.errors, **errors))
    places = []
    with open_sim("living_room", seed, twin) as (robot, _):
        for rate in (SLOW, FAST):
            config = Config(sweep=SweepConfig(width=math.tau, margin=0.0, yaw_rate=rate))
            both = [
                sweep(robot, 0.0, config, lambda line: None, rightwards=side).image
                for side in (True, False)
            ]
            places.append(both)
        table = robot.turntable
        assert isinstance(table, SimTurntable)
    nominal = table.spec.play
    return Taken(places, find_true(pattern, errors, table.play - nominal), nominal)


def take_by_base(seed: int) -> Taken:
    """Return the sweeps of a Create that turns, and what is true of how it stands."""
    errors = {name: value for name, value in draw_errors(seed).items() if name[:5] == "mount"}
    errors.pop("mount_yaw")
    twin = replace(TwinConfig(), errors=replace(TwinConfig().errors, **errors))
    images = []
    with open_sim("living_room", seed, twin) as (robot, truth):
        for width, side in ((math.tau, True), (mount.BACK, True), (mount.BACK, False)):
            config = Config(sweep=SweepConfig(width=width, margin=0.0, yaw_rate=BASE_RATE))
            images.append(sweep(robot, 0.0, config, lambda line: None, rightwards=side).image)
        robot.lidar.read_line(1.0)
        across, _ = mount.turning(images[0], truth)
        true = {
            "lateral": errors["mount_lateral"] + across,
            "roll": math.copysign(mount.lean(truth), errors["mount_roll"]),
            "pitch": look_down(truth, images[0]),
        }
    return Taken([images[:1], images[1:]], true)


def look_down(truth: Truth, image: RangeImage) -> float:
    """Return by how much the lidar looks down now [rad]: from the beam ahead."""
    evidence = truth.evidence()
    assert evidence is not None
    middle = image.spec.n_beams // 2
    return float(image.spec.elevations[middle] - math.asin(evidence.directions[middle][2]))


def judge(taken: Taken, found: Calibration) -> dict[str, bool]:
    """Return whether each of ``KINDS`` is found; those that the robot has."""
    verdicts: dict[str, bool] = {}
    for name, true in taken.true.items():
        kind = {"lateral": "lever", "play": "play"}.get(
            name, name[:4] if "axis" in name else "tilt"
        )
        off = abs(getattr(found.mount, name) - true)
        if kind == "lever":
            right = off <= max(LEVER_LIMIT, 0.1 * abs(true))
        elif kind == "play":
            right = off <= 0.2 * (true + taken.nominal_play)
        else:
            right = off <= max(TILT_LIMIT, 0.1 * abs(true))
        known = found.known[found.names.index(name)]
        verdicts[kind] = verdicts.get(kind, True) and right and known
    return verdicts


def describe(taken: Taken, found: Calibration) -> str:
    """Return what was found, and in parentheses what is true."""
    parts = []
    for name, true in taken.true.items():
        factor = 1e3 if name == "lateral" else math.degrees(1.0)
        sigma = found.sigmas[found.names.index(name)]
        value = getattr(found.mount, name)
        parts.append(f"{name} {factor * value:.2f} +- {factor * sigma:.2f} ({factor * true:.2f})")
    return ", ".join(parts)


def run(pattern: str, seed: int) -> dict[str, bool]:
    """Return what of one robot is found, and print it."""
    taken = take_by_base(seed) if pattern == "yaw-base" else take_by_table(pattern, seed)
    return report(pattern, seed, taken)


def report(pattern: str, seed: int, taken: Taken) -> dict[str, bool]:
    """Return what of one robot is found, and print it."""
    found = calibrate(taken.places)
    verdicts = judge(taken, found)
    missed = [kind for kind, right in verdicts.items() if not right]
    words = f"MISSED {' '.join(missed)}" if missed else "found"
    print(f"{pattern} {seed} {words}: {describe(taken, found)}", file=sys.stderr, flush=True)
    return verdicts


def make_row(verdicts: list[dict[str, bool]]) -> dict[str, int | None]:
    """Return of how many robots each of ``KINDS`` and all of them were found; None if none has."""
    row: dict[str, int | None] = {
        kind: sum(each[kind] for each in verdicts) if kind in verdicts[0] else None
        for kind in KINDS
    }
    return row | {"all": sum(all(each.values()) for each in verdicts)}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pattern", choices=PATTERNS, action="append")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + given.seeds)
    rows = {
        pattern: make_row([run(pattern, seed) for seed in seeds])
        for pattern in given.pattern or PATTERNS
    }
    if given.json:
        print(json.dumps(rows, indent=1))
        return
    print("| pattern | lever | tilt | play | axis | all |\n|---|---|---|---|---|---|")
    for pattern, row in rows.items():
        print(f"| `{pattern}` | {' | '.join('-' if n is None else str(n) for n in row.values())} |")


if __name__ == "__main__":
    main()
