"""Whole loops with a turntable, in the twin alone and through the drivers of all devices.

``python benchmarks/wired_turntable.py [--pattern yaw] [--seeds 2] [--scene NAME] [--max-views 12]``
digitises by each pattern, from seed 1001 on, once in the twin and once through the drivers of base,
lidar and servo on their emulated bytes, and prints views, the error of the worst pair, coverage,
the median error of the points and what the servo's line lost; with ``--json`` as JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace

import scan3d_twin as s3d
from scan3d_twin.core.hal import Robot
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.truth import Truth
from scan3d_twin.wired import open_wired

TABLES = ("yaw", "pitch", "roll")
FIRST_SEED = 1001
Opener = Callable[..., AbstractContextManager[tuple[Robot, Truth]]]
OPENERS: dict[str, Opener] = {"sim": open_sim, "wired": open_wired}


@dataclass(frozen=True)
class Loop:
    """What one run reached.

    Attributes:
        views: Number of views.
        worst_mm: Largest error of a registered pair [mm]; 0 for a single view.
        coverage: Share of the target that is seen, 0..1.
        accuracy_mm: Median distance of its points from the truth [mm].
        bad: Packets of the servo that were lost or damaged.
        time_s: On the robot's clock [s].
    """

    views: int
    worst_mm: float
    coverage: float
    accuracy_mm: float
    bad: int
    time_s: float


def run(opener: Opener, pattern: str, seed: int, scene: str, max_views: int) -> Loop:
    """Return what one run by ``pattern`` reached."""
    twin = replace(s3d.TwinConfig(), pattern=pattern)
    with opener(scene, seed, twin) as (robot, truth):
        session = s3d.digitize(robot, s3d.Config(max_views=max_views), seed=seed)
        result, time = s3d.evaluate(session, truth), robot.clock.now()
        bad = getattr(getattr(robot.turntable, "stats", None), "bad", 0)
    worst = max((pair.error for pair in result.pairs), default=0.0)
    return Loop(
        len(session.views), round(1e3 * worst, 1), round(result.coverage, 3),
        round(1e3 * result.accuracy.median, 1), bad, round(time, 1),
    )  # fmt: skip


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pattern", choices=TABLES, action="append")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scene", default="three_boxes")
    parser.add_argument("--max-views", type=int, default=12)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = []
    for pattern in given.pattern or TABLES:
        for seed in range(FIRST_SEED, FIRST_SEED + given.seeds):
            for name, opener in OPENERS.items():
                loop = run(opener, pattern, seed, given.scene, given.max_views)
                rows.append({"pattern": pattern, "seed": seed, "by": name, **asdict(loop)})
                print(*rows[-1].values(), file=sys.stderr, flush=True)
    if given.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"| {' | '.join(rows[0])} |\n|{'---|' * len(rows[0])}")
    for row in rows:
        print(f"| {' | '.join(map(str, row.values()))} |")


if __name__ == "__main__":
    main()
