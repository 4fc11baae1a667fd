"""Simulated ICP, the paper's planner (section 5, eq. 2 to 6 and the pseudo-code).

For growing overlaps eta the next scan is simulated as a displaced, noisy copy of the part Q of the
current scan it would share, and registered with ICP. The smallest overlap whose registration error
E stays within epsilon wins; if there is none, the overlap is 80 %.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.config import Criterion, PlanningConfig
from scan3d_twin.core.planning.situation import Situation, blocked, finish, in_world
from scan3d_twin.core.registration import cut_lines, register
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import (
    Candidate,
    FloatArray,
    Plan,
    Pose2,
    RegistrationResult,
    Scan3D,
    rms,
)


class SiicpPlanner:
    """The SiICP planner; all its knobs are in ``config.planning``."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose simulated error meets epsilon."""
        situation, config = Situation(session), session.config.planning
        if reason := situation.finished():
            return finish(reason)
        candidates: list[Candidate] = []
        for eta, draws in _with_generators(overlaps(config), rng):
            placement = situation.place(eta)
            if not placement.wanted and not situation.looked:
                return blocked(situation)
            if placement.viewpoint is None:
                continue
            error = simulated_error(situation, eta, placement.viewpoint, draws)
            viewpoint = in_world(situation, placement.viewpoint)
            candidates.append(Candidate(viewpoint, eta, error, feasible=True))
            if error <= config.epsilon:
                return _chosen(candidates[-1], candidates, fell_back=False)
        return _default(situation, candidates, config)


def overlaps(config: PlanningConfig) -> list[float]:
    """Return the overlaps eta to try, smallest first."""
    steps = math.floor((config.eta_max - config.eta_min) / config.eta_step + 1e-9)
    return [round(config.eta_min + k * config.eta_step, 9) for k in range(steps + 1)]


def simulated_error(
    situation: Situation, overlap: float, viewpoint: Pose2, rng: np.random.Generator
) -> float:
    """Return the error E [m] of the simulated registration, steps a to f of the pseudo-code.

    Args:
        situation: With the current scan P.
        overlap: eta; Q is the last eta * n lines of P.
        viewpoint: The candidate O2 in frame ``scan`` of P, where O1 is the origin.
        rng: For the random motion errors and the noise.

    Returns:
        The ``quantile`` order statistic over the ``trials`` draws, rounded up; a draw in which ICP
        finds no correspondences counts as infinite.
    """
    config = situation.session.config.planning
    n_Q = situation.n_Q(overlap)
    Q = situation.view.target.last_lines(n_Q)
    Q_prime = _surface(situation, config).last_lines(n_Q)
    Q_prime = Q_prime.middle_lines(max(1, round(config.alpha * n_Q)))  # eq. (5)
    border = cut_lines(Q, right=not situation.ends)
    tree = cKDTree(Q.points)
    errors = []
    for _ in range(config.trials):
        R_T = draw_motion_error(viewpoint, config, rng)  # eq. (2)
        N_noise = config.sigma * rng.standard_normal(Q_prime.points.shape)
        Q_virtual = R_T.apply(Q_prime.points) + N_noise  # eq. (6)
        result = register(
            Q.points,
            Q_virtual,
            border=border,
            config=situation.session.config.registration,
            tree=tree,
        )
        errors.append(_error(result, R_T, Q_prime.points, Q_virtual, config.criterion))
    return float(np.quantile(errors, config.quantile, method="higher"))


def _surface(situation: Situation, config: PlanningConfig) -> Scan3D:
    """Return the points that are scanned virtually: those of P, with or without its noise.

    The noise of P is a texture that Q and a copy of it share, and two real scans do not: ICP would
    find it again on the barest wall.
    """
    if config.virtual_scan == "copy":
        return situation.view.target
    return situation.view.target.on(situation.smoothed)


def _error(
    result: RegistrationResult,
    R_T: Pose2,
    Q_prime: FloatArray,
    Q_virtual: FloatArray,
    criterion: Criterion,
) -> float:
    """Return E of one draw: eq. (3), index by index, without or with the noise, or the residual."""
    if result.num_inliers == 0:
        return math.inf
    T = Pose2.from_matrix(result.T_target_source)
    if criterion == "displacement":
        return rms((T @ R_T).apply(Q_prime) - Q_prime)
    if criterion == "eq3":
        return rms(T.apply(Q_virtual) - Q_prime)
    return result.inlier_rmse


def draw_motion_error(viewpoint: Pose2, config: PlanningConfig, rng: np.random.Generator) -> Pose2:
    """Draw R and T of eq. (2): errors proportional to the move along x and y and to the turn."""
    x, y, yaw = rng.standard_normal(3)
    return Pose2(
        x * config.lambda_ * abs(viewpoint.x),
        y * config.lambda_ * abs(viewpoint.y),
        yaw * config.gamma * abs(viewpoint.yaw),
    )


def _with_generators(
    etas: list[float], rng: np.random.Generator
) -> list[tuple[float, np.random.Generator]]:
    """Give each overlap a generator of its own, so that results do not depend on the order."""
    return list(zip(etas, rng.spawn(len(etas)), strict=True))


def _chosen(candidate: Candidate, candidates: list[Candidate], fell_back: bool) -> Plan:
    reason = (
        f"no overlap meets epsilon: default {candidate.overlap:.0%}"
        if fell_back
        else f"smallest overlap that meets epsilon: {candidate.overlap:.0%}"
    )
    return Plan(
        candidate.viewpoint,
        candidate.overlap,
        candidate.predicted_rmse,
        fell_back,
        tuple(candidates),
        reason,
    )


def _default(situation: Situation, candidates: list[Candidate], config: PlanningConfig) -> Plan:
    """Return the plan for a featureless surface: the default overlap, whatever its error."""
    placement = situation.place(config.default_overlap)
    if placement.viewpoint is None:
        return blocked(situation)
    error = next(
        (c.predicted_rmse for c in candidates if c.overlap == config.default_overlap), math.nan
    )
    viewpoint = in_world(situation, placement.viewpoint)
    default = Candidate(viewpoint, config.default_overlap, error, feasible=True)
    return _chosen(default, candidates, fell_back=True)
