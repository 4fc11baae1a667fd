"""Fit the motion-error constants to the `typical` robot of the twin.

The constants are those of eq. (2), of the motion prior of a turn, a drive and a turn
(``core/mapping/scan_matching.py``: lambda, gamma and drift), and of the robot without physics
(``sim/base/motion_errors.py``: creep and slip).

Each robot moves from one viewpoint to the next as a planner would ask: turn, drive, turn.
The error of a move is its odometry against the truth, in the frame of the start:

    x_u ~ N(0, (lambda dx)^2), y_u ~ N(0, (lambda dy)^2), theta_u ~ N(0, (gamma dtheta)^2)

These are maximum-likelihood fits. For the prior, the mean squared Mahalanobis distance of the moves
per degree of freedom follows, which is 1 if the prior fits. Then come the errors that are left when
the constants of each robot are known (``core/mapping/motion_model.py``). Creep and slip are a
least-squares fit and its residual. Last come medians and 90 % quantiles of the odometry's error on
the same moves, with physics and without, for robots of the same seeds.

Run: ``python benchmarks/motion_error.py [--robots 40] [--json]``.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from scan3d_twin.core.config import Config, MotionConfig
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.motion_prior import motion_prior
from scan3d_twin.core.navigation.legs import Legs, measure_legs
from scan3d_twin.core.navigation.motion_control import drive_to, turn_to
from scan3d_twin.core.registration.pose_prior import PLANAR
from scan3d_twin.core.types import FloatArray, Pose2, wrap
from scan3d_twin.devices.create.model import CREATE2
from scan3d_twin.sim.base.motion_errors import (
    SLIP_XY,
    SLIP_YAW,
    TURN_CREEP,
    apply_motion_errors,
)
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.robot import draw_robot, open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.world import RobotErrors

MOVES_PER_ROBOT = 4
STEP = (0.2, 1.2)
"""Length of a move [m]: the steps the planner makes at overlaps of 80 and 20 %."""
TURN = math.pi / 2
"""Largest change of heading between two viewpoints [rad]."""


class Move(NamedTuple):
    """One move of a robot with physics.

    Attributes:
        start: ``T_odom_base`` before.
        end: ``T_odom_base`` after.
        true: The true move, from where it started.
        robot: Its errors.
        legs: Its turns and drives.
    """

    start: Pose2
    end: Pose2
    true: Pose2
    robot: RobotErrors
    legs: Legs

    @property
    def measured(self) -> Pose2:
        """The move by odometry."""
        return self.start.inverse() @ self.end

    @property
    def drifted(self) -> Pose2:
        """The move of the robot without physics, but for its slip."""
        path = np.array([[self.end.x, self.end.y]])
        return apply_motion_errors(self.start, path, self.end.yaw, CREATE2, self.robot)


def moves(seed: int) -> list[Move]:
    """Return the moves of one robot, drawn by ``seed``."""
    rng = np.random.default_rng([seed, 99])
    config, result, scene = MotionConfig(), [], load_scene("sine_box")
    drawn = draw_robot(scene, seed, RobotErrorConfig())
    with open_sim(scene, seed) as (robot, truth):
        for k in range(MOVES_PER_ROBOT):
            here, true_here = robot.base.odometry().T_odom_base, truth.pose_at(robot.clock.now())
            # Past the target from side to side, as between two viewpoints.
            started = robot.clock.now()
            side = here.y + (-1) ** k * rng.uniform(*STEP)
            goal = Pose2(0.0, side, rng.uniform(-TURN, TURN))
            drive_to(robot, goal.x, goal.y, config)
            turn_to(robot, goal.yaw, config)
            robot.clock.sleep(0.5)
            there, true_there = robot.base.odometry().T_odom_base, truth.pose_at(robot.clock.now())
            way = [sample.T_odom_base for sample in robot.base.odometry_since(started)]
            legs = measure_legs(here, way, there.yaw)
            result.append(Move(here, there, true_here.inverse() @ true_there, drawn, legs))
    return result


def fit(pairs: list[tuple[Pose2, Pose2]]) -> tuple[float, float]:
    """Return the maximum-likelihood lambda and gamma of (move by odometry, true move) pairs."""
    error = np.array([[t.x - m.x, t.y - m.y, wrap(t.yaw - m.yaw)] for m, t in pairs])
    move = np.array([[m.x, m.y, m.yaw] for m, _ in pairs])
    lambda_ = math.sqrt(np.sum(error[:, :2] ** 2) / np.sum(move[:, :2] ** 2))
    gamma = math.sqrt(np.sum(error[:, 2] ** 2) / np.sum(move[:, 2] ** 2))
    return lambda_, gamma


def misfit(pairs: list[tuple[Pose2, Pose2]], constants: FloatArray) -> tuple[float, float]:
    """Return -2 log likelihood of the motion prior and the mean squared distance per dimension.

    Args:
        pairs: (move by odometry, true move).
        constants: Logarithms of lambda, gamma and drift (3,).
    """
    lambda_, gamma, drift = np.exp(constants)
    config = replace(Config.preset("paper").planning, lambda_=lambda_, gamma=gamma, drift=drift)
    total, square = 0.0, 0.0
    for measured, true in pairs:
        C = motion_prior(measured, config).covariance[np.ix_(PLANAR, PLANAR)]
        e = np.array([true.x - measured.x, true.y - measured.y, wrap(true.yaw - measured.yaw)])
        distance = float(e @ np.linalg.solve(C, e))
        total, square = total + float(np.linalg.slogdet(C)[1]) + distance, square + distance
    return total, square / (3 * len(pairs))


def fit_prior(pairs: list[tuple[Pose2, Pose2]]) -> tuple[float, float, float, float]:
    """Return lambda, gamma and drift of the motion prior and the distance at them."""
    start = np.log([0.03, 0.026, 0.036])
    found = minimize(lambda x: misfit(pairs, x)[0], start, method="Nelder-Mead").x
    lambda_, gamma, drift = np.exp(found)
    return float(lambda_), float(gamma), float(drift), misfit(pairs, found)[1]


def fit_constants(driven: list[Move]) -> tuple[float, float]:
    """Return what is left of the errors [m], [rad], RMS, with the constants of each robot fitted.

    A robot has three constants and three errors of each of its moves.
    """
    model, left = MotionModel.of((), Config()), []
    for robot in dict.fromkeys(id(move.robot) for move in driven):
        own = [move for move in driven if id(move.robot) == robot]
        A = np.concatenate([model.jacobian(move.measured, move.legs) for move in own])
        d = np.concatenate([error(move.measured, move.true) for move in own])
        weights = np.tile([1.0, 1.0, STEP[1]], len(own))
        found = np.linalg.lstsq(weights[:, None] * A, weights * d, rcond=None)[0]
        left.append((d - A @ found).reshape(-1, 3) * math.sqrt(len(d) / (len(d) - 3)))
    residuals = np.concatenate(left)
    xy, yaw = np.sqrt(np.mean(residuals[:, :2] ** 2)), np.sqrt(np.mean(residuals[:, 2] ** 2))
    return float(xy), float(yaw)


def error(measured: Pose2, true: Pose2) -> FloatArray:
    """Return by how much a move errs (3,) [m], [m], [rad]."""
    return np.array([true.x - measured.x, true.y - measured.y, wrap(true.yaw - measured.yaw)])


def fit_drift(driven: list[Move]) -> tuple[float, float, float]:
    """Return creep [rad/rad] and the standard deviations of the slip [m], [rad]."""
    left = np.array([error(move.drifted, move.true) for move in driven])
    turn = np.array([wrap(move.measured.yaw) / move.robot.friction for move in driven])
    more = -float(turn @ left[:, 2] / (turn @ turn))
    left[:, 2] += more * turn
    across, yaw = (float(np.sqrt(np.mean(part**2))) for part in (left[:, :2], left[:, 2]))
    return TURN_CREEP + more, across, yaw


def compare(driven: list[Move], rng: np.random.Generator) -> dict[str, FloatArray]:
    """Return medians and 90 % quantiles (2, 2) [m], [rad] of the errors, of either robot."""
    slip = rng.standard_normal((len(driven), 3)) * (SLIP_XY, SLIP_XY, SLIP_YAW)
    slipped = [
        move.drifted @ Pose2(*each) for move, each in zip(driven, slip.tolist(), strict=True)
    ]
    result = {}
    for name, true in (("physics", [move.true for move in driven]), ("kinematic", slipped)):
        errors = np.array([error(move.measured, t) for move, t in zip(driven, true, strict=True)])
        size = np.stack([np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])])
        result[name] = np.quantile(size, (0.5, 0.9), axis=1).T
    return result


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    driven = [move for seed in range(1000, 1000 + options.robots) for move in moves(seed)]
    pairs = [(move.measured, move.true) for move in driven]
    rng = np.random.default_rng(0)
    draws = np.array(
        [fit([pairs[i] for i in rng.integers(len(pairs), size=len(pairs))]) for _ in range(200)]
    )
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    values, prior = fit(pairs), fit_prior(pairs)
    names_of_prior = ("prior_lambda", "prior_gamma", "prior_drift", "prior_distance")
    left = dict(zip(("left_xy", "left_yaw"), fit_constants(driven), strict=True))
    drift = left | dict(zip(("creep", "slip_xy", "slip_yaw"), fit_drift(driven), strict=True))
    for name, quantiles in compare(driven, rng).items():
        drift |= {f"{name}_xy_50": quantiles[0, 0], f"{name}_xy_90": quantiles[0, 1]}
        drift |= {f"{name}_yaw_50": quantiles[1, 0], f"{name}_yaw_90": quantiles[1, 1]}
    if options.json:
        names = {"lambda": ("m/m", 0), "gamma": ("rad/rad", 1)}
        rows = {
            name: {"value": values[i], "unit": unit, "peer": None, "runs": len(pairs)}
            for name, (unit, i) in names.items()
        }
        units = ("m/m", "rad/rad", "rad/m", "1")
        for name, value, unit in zip(names_of_prior, prior, units, strict=True):
            rows[name] = {"value": value, "unit": unit, "peer": None, "runs": len(pairs)}
        for name, value in drift.items():
            unit = "m" if "xy" in name else "rad"
            rows[name] = {"value": float(value), "unit": unit, "peer": None, "runs": len(pairs)}
        print(json.dumps(rows))
        return
    for i, name in enumerate(("lambda", "gamma")):
        print(
            f"{name:7} {values[i]:.4f}  (95 %: {low[i]:.4f} to {high[i]:.4f}, {len(pairs)} moves)"
        )
    for name, value in zip(names_of_prior, prior, strict=True):
        print(f"{name:14} {value:.4f}")
    for name, value in drift.items():
        print(f"{name:16} {value:.5f}")


if __name__ == "__main__":
    main()
