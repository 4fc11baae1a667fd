"""Fit the motion-error constants lambda and gamma of eq. (2) to the `typical` robot of the twin.

Each robot makes moves from one viewpoint to the next as the planner asks for: turn, drive, turn.
The error of a move is its odometry against the truth, in the frame of the start:

    x_u ~ N(0, (lambda dx)^2), y_u ~ N(0, (lambda dy)^2), theta_u ~ N(0, (gamma dtheta)^2)

Run: ``python benchmarks/motion_error.py [--robots 40] [--json]``.
"""

from __future__ import annotations

import argparse
import json
import math

import numpy as np

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.motion import drive_to, turn_to
from scan3d_twin.core.types import Pose2, wrap
from scan3d_twin.sim.robot import open_sim

MOVES_PER_ROBOT = 4
STEP = (0.2, 1.2)
"""Length of a move [m]: the steps the planner makes at overlaps of 80 and 20 %."""
TURN = math.pi / 2
"""Largest change of heading between two viewpoints [rad]."""


def moves(seed: int) -> list[tuple[Pose2, Pose2]]:
    """Return (move by odometry, true move) of one robot, drawn by ``seed``."""
    rng = np.random.default_rng([seed, 99])
    config, result = MotionConfig(), []
    with open_sim("sine_box", seed) as (robot, truth):
        for k in range(MOVES_PER_ROBOT):
            here, true_here = robot.base.odometry().T_odom_base, truth.pose_at(robot.clock.now())
            # Past the target from side to side, as between two viewpoints.
            side = here.y + (-1) ** k * rng.uniform(*STEP)
            goal = Pose2(0.0, side, rng.uniform(-TURN, TURN))
            drive_to(robot, goal.x, goal.y, config)
            turn_to(robot, goal.yaw, config)
            robot.clock.sleep(0.5)
            there, true_there = robot.base.odometry().T_odom_base, truth.pose_at(robot.clock.now())
            result.append((here.inverse() @ there, true_here.inverse() @ true_there))
    return result


def fit(pairs: list[tuple[Pose2, Pose2]]) -> tuple[float, float]:
    """Return the maximum-likelihood lambda and gamma of (move by odometry, true move) pairs."""
    error = np.array([[t.x - m.x, t.y - m.y, wrap(t.yaw - m.yaw)] for m, t in pairs])
    move = np.array([[m.x, m.y, m.yaw] for m, _ in pairs])
    lambda_ = math.sqrt(np.sum(error[:, :2] ** 2) / np.sum(move[:, :2] ** 2))
    gamma = math.sqrt(np.sum(error[:, 2] ** 2) / np.sum(move[:, 2] ** 2))
    return lambda_, gamma


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    pairs = [pair for seed in range(1000, 1000 + options.robots) for pair in moves(seed)]
    rng = np.random.default_rng(0)
    draws = np.array(
        [fit([pairs[i] for i in rng.integers(len(pairs), size=len(pairs))]) for _ in range(200)]
    )
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    values = fit(pairs)
    if options.json:
        names = {"lambda": ("m/m", 0), "gamma": ("rad/rad", 1)}
        rows = {
            name: {"value": values[i], "unit": unit, "peer": None, "runs": len(pairs)}
            for name, (unit, i) in names.items()
        }
        print(json.dumps(rows))
        return
    for i, name in enumerate(("lambda", "gamma")):
        print(
            f"{name:7} {values[i]:.4f}  (95 %: {low[i]:.4f} to {high[i]:.4f}, {len(pairs)} moves)"
        )


if __name__ == "__main__":
    main()
