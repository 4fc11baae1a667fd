"""Views of a stand that is set down by hand, registered without odometry.

``python benchmarks/stand.py [--seeds 30] [--scene living_room] [--pattern yaw] [--json]`` prints
one object {name: {value, unit, runs}}. Each seed is another stand of the `typical` world,
which scans all round from places drawn within 0.5 m and 30 deg of the scene's spawn, so that any
two are within 1 m and 60 deg of each other. A view is off by the root mean square displacement of
all its points, the first view laid on the truth. It is right within 10 mm; otherwise it must be
named: left out, or called unsure by the report (another place fits almost as well, a direction is
open, or it may be off by more than 10 mm).
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.api.add_view import PLACE_STREAM, draw_place
from scan3d_twin.core.config import Config, TargetConfig
from scan3d_twin.core.errors import RegistrationError, SceneError
from scan3d_twin.core.placed_views import begin_placed_session, integrate_placed
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.scanning.upright import make_upright
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2, rms
from scan3d_twin.run.run_warnings import describe_doubts
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

LIMIT = 0.010
"""Error of a right view [m]."""
REST = 5.0
"""Time that passes before each view, so that its noise is another [s]."""


@dataclass(frozen=True)
class Found:
    """What became of a view.

    Attributes:
        error: RMS displacement of its points [m]; NaN if it was left out.
        expected: Error that nine of ten such views stay below [m].
        named: Whether the report calls it unsure, or it was left out.
    """

    error: float
    expected: float
    named: bool


def scan(scene: str, seed: int, views: int, pattern: str) -> list[tuple[Observation, Pose2]]:
    """Return the views of one stand from places drawn by ``seed``, and where they truly are."""
    loaded, config = load_scene(scene), Config()
    twin = replace(TwinConfig(), robot="stand", pattern=pattern)
    rng, taken = np.random.default_rng([seed, 0, PLACE_STREAM]), []
    while len(taken) < views:
        place = loaded.spawn @ draw_place(rng)
        try:
            with open_sim(replace(loaded, spawn=place), seed, twin) as (robot, truth):
                robot.clock.sleep(REST * len(taken))
                seen = sweep(robot, 0.0, config, lambda line: None)
                true = truth.pose_at(robot.clock.now())
        except SceneError:
            continue
        taken.append((Observation(seen.image, Pose2(), has_odometry=False), true))
    return taken


def register(views: list[tuple[Observation, Pose2]], mode: str) -> list[Found]:
    """Return what became of each view but the first."""
    # Register one after the other
    config = Config(target=TargetConfig(extraction=mode))
    session, true, left_out = begin_placed_session(views[0][0], config), [views[0][1]], 0
    for observation, pose in views[1:]:
        upright = replace(observation, image=make_upright(observation.image))
        try:
            session = integrate_placed(session, upright)
        except RegistrationError as error:
            print(error, file=sys.stderr)
            left_out += 1
            continue
        true.append(pose)
    return [*_judge(session, true), *[Found(math.nan, math.nan, True)] * left_out]


def _judge(session: Session, true: list[Pose2]) -> list[Found]:
    doubts = describe_doubts(session)
    found = []
    for k, view in enumerate(session.views[1:], 1):
        points = view.sweep.points
        placed = true[0] @ session.views[0].T_world_scan.inverse() @ view.T_world_scan
        assert view.registration is not None
        expected = session.config.registration.calibration * view.registration.predicted_rmse
        named = any(words.startswith((f"View {k}:", f"View {k} ")) for words in doubts)
        found.append(Found(rms(placed.apply(points) - true[k].apply(points)), expected, named))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--scene", default="living_room")
    parser.add_argument("--pattern", default="yaw")
    parser.add_argument("--model", default="everything")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()

    every: list[Found] = []
    for seed in range(given.first, given.first + given.seeds):
        found = register(scan(given.scene, seed, given.views, given.pattern), given.model)
        every += found
        shown = [f"{1e3 * f.error:.1f}{'?' if f.named else ''}" for f in found]
        print(seed, *shown, file=sys.stderr, flush=True)

    errors = np.array([f.error for f in every])
    right = errors <= LIMIT
    named = np.array([f.named for f in every])
    within = errors <= np.array([f.expected for f in every])
    placed = np.isfinite(errors)
    n = len(every)
    rows = {
        "right_or_named": (float(np.mean(right | named)), "share"),
        "right": (float(np.mean(right)), "share"),
        "named": (float(np.mean(named)), "share"),
        "named_though_right": (float(np.mean(named & right)), "share"),
        "error_median": (1e3 * float(np.median(errors[placed])), "mm"),
        "error_largest": (1e3 * float(np.max(errors[placed])), "mm"),
        "below_stated": (float(np.mean(within[placed])), "share"),
    }
    result = {k: {"value": round(v, 4), "unit": unit, "runs": n} for k, (v, unit) in rows.items()}
    if given.json:
        print(json.dumps(result, indent=2))
    else:
        for name, row in result.items():
            print(f"{name:20} {row['value']:8.3f} {row['unit']}  ({n} views)")


if __name__ == "__main__":
    main()
