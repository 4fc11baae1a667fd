"""Simulated ICP, the paper's planner (section 5, eq. 2 to 6 and the pseudo-code).

For growing overlaps eta the next scan is simulated as a displaced, noisy copy of the part Q of the
current scan it would share, and registered with ICP. The smallest overlap whose registration error
E stays within epsilon wins; if there is none, the overlap is 80 %. ``planning.virtual_scan =
visible`` simulates what would be seen from the candidate instead (``simulate``).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.config import Criterion, PlanningConfig
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.context import PlanningContext, blocked, in_world
from scan3d_twin.core.planning.hidden_views import termination_plan
from scan3d_twin.core.planning.simulated_registration import Simulation
from scan3d_twin.core.registration.icp import find_border, register
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
    """Simulated ICP (the paper): the smallest overlap whose registration meets epsilon."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose simulated error meets epsilon."""
        context, config = PlanningContext(session), session.config.planning
        if plan := termination_plan(context):
            return plan
        if config.virtual_scan == "visible":
            return smallest_overlap(context, _visible_error(context, rng))
        etas = overlaps(config)
        luck = dict(zip(etas, sample_motion_noise(len(etas), config, rng), strict=True))
        noise = dict(zip(etas, rng.spawn(len(etas)), strict=True))
        return smallest_overlap(
            context, lambda eta, O2: simulated_error(context, eta, O2, luck[eta], noise[eta])
        )


def smallest_overlap(context: PlanningContext, error: Callable[[float, Pose2], float]) -> Plan:
    """Return the plan for the smallest overlap whose error meets epsilon.

    Args:
        context: Not finished.
        error: Of an overlap and its viewpoint in frame ``scan`` [m].
    """
    config = context.session.config.planning
    candidates: list[Candidate] = []
    for eta in overlaps(config):
        placement = context.place(eta)
        if not placement.wanted and not context.looked:
            return blocked(context)
        if placement.viewpoint is None:
            continue
        viewpoint, E = in_world(context, placement.viewpoint), error(eta, placement.viewpoint)
        candidates.append(Candidate(viewpoint, eta, E, feasible=True))
        if config.epsilon >= E:
            return chosen(candidates[-1], candidates, fell_back=False)
    return default_plan(context, candidates, config)


def _visible_error(
    context: PlanningContext, rng: np.random.Generator
) -> Callable[[float, Pose2], float]:
    """Return the error of a viewpoint by simulated registration of what would be seen there."""
    try:
        simulation = Simulation.of(context, int(rng.integers(2**63)))
    except RegistrationError:
        return lambda eta, O2: math.inf
    return lambda eta, O2: simulation.error(O2, context.session.config.planning.trials)


def overlaps(config: PlanningConfig) -> list[float]:
    """Return the overlaps eta to try, smallest first."""
    steps = math.floor((config.eta_max - config.eta_min) / config.eta_step + 1e-9)
    return [round(config.eta_min + k * config.eta_step, 9) for k in range(steps + 1)]


def simulated_error(
    context: PlanningContext,
    overlap: float,
    viewpoint: Pose2,
    draws: FloatArray,
    rng: np.random.Generator,
) -> float:
    """Return the error E [m] of the simulated registration, steps a to f of the pseudo-code.

    Args:
        context: With the current scan P.
        overlap: eta; Q is the last eta * n lines of P.
        viewpoint: The candidate O2 in frame ``scan`` of P, where O1 is the origin.
        draws: Standard normal draws for x, y and yaw (trials, 3).
        rng: For the noise.

    Returns:
        The ``quantile`` order statistic over the draws, rounded up; a draw in which ICP
        finds no correspondences counts as infinite.
    """
    config = context.session.config.planning
    n_Q = context.n_Q(overlap)
    Q = context.P.last_lines(n_Q)
    Q_prime = _surface(context, config).last_lines(n_Q)
    Q_prime = Q_prime.middle_lines(max(1, round(config.alpha * n_Q)))  # eq. (5)
    border = find_border(Q, right=not context.ends)
    tree = cKDTree(Q.points)
    errors = []
    for draw in draws:
        R_T = motion_error(draw, viewpoint, config)  # eq. (2)
        N_noise = config.sigma * rng.standard_normal(Q_prime.points.shape)
        Q_virtual = R_T.apply(Q_prime.points) + N_noise  # eq. (6)
        result = register(
            Q.points,
            Q_virtual,
            border=border,
            config=context.session.config.registration,
            tree=tree,
        )
        errors.append(_error(result, R_T, Q_prime.points, Q_virtual, config.criterion))
    return float(np.quantile(errors, config.quantile, method="higher"))


def _surface(context: PlanningContext, config: PlanningConfig) -> Scan3D:
    """Return the points that are scanned virtually: those of P, with or without its noise.

    The noise of P is a texture that Q and a copy of it share, and two real scans do not: ICP would
    find it again on the barest wall.
    """
    if config.virtual_scan == "copy":
        return context.P
    return context.P.on(context.smoothed)


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


def sample_motion_noise(
    overlaps: int, config: PlanningConfig, rng: np.random.Generator
) -> FloatArray:
    """Draw standard normal numbers (overlaps, trials, 3) for the motion errors.

    ``common`` draws are the same for all overlaps: with luck of its own each, trying seven overlaps
    would be seven chances for one lucky draw to end the search.
    """
    if config.draws == "independent":
        return rng.standard_normal((overlaps, config.trials, 3))
    return np.broadcast_to(rng.standard_normal((config.trials, 3)), (overlaps, config.trials, 3))


def motion_error(draw: FloatArray, viewpoint: Pose2, config: PlanningConfig) -> Pose2:
    """Return R and T of eq. (2): errors proportional to the move along x and y and to the turn."""
    x, y, yaw = draw
    return Pose2(
        x * config.lambda_ * abs(viewpoint.x),
        y * config.lambda_ * abs(viewpoint.y),
        yaw * config.gamma * abs(viewpoint.yaw),
    )


def chosen(candidate: Candidate, candidates: list[Candidate], fell_back: bool) -> Plan:
    """Return the plan to go to ``candidate``."""
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


def default_plan(
    context: PlanningContext, candidates: list[Candidate], config: PlanningConfig
) -> Plan:
    """Return the plan for a featureless surface: the default overlap, whatever its error."""
    placement = context.place(config.default_overlap)
    if placement.viewpoint is None:
        return blocked(context)
    error = next(
        (c.predicted_rmse for c in candidates if c.overlap == config.default_overlap), math.nan
    )
    viewpoint = in_world(context, placement.viewpoint)
    default = Candidate(viewpoint, config.default_overlap, error, feasible=True)
    return chosen(default, candidates, fell_back=True)
