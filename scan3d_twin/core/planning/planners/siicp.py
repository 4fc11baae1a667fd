"""Simulated ICP (SiICP), the paper's planner (section 5, eq. 2 to 6 and the pseudo-code).

For growing overlaps eta the next scan is simulated as a displaced, noisy copy of the part Q of the
current scan that it would share, and registered with ICP. The smallest overlap whose registration
error E stays within epsilon wins; else the overlap is 80 % (``overlap_or_default``). The
displacement is by the module ``motion_error``, eq. (2), and E by ``error_measure``, eq. (3). With
``planning.virtual_scan = visible`` the planner simulates what would be seen from the candidate
instead (``simulated_registration``).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import list_overlaps, plan_smallest_overlap
from scan3d_twin.core.planning.prediction.error_measure import measure_error
from scan3d_twin.core.planning.prediction.motion_error import (
    sample_motion_noise,
    scale_motion_error,
)
from scan3d_twin.core.planning.prediction.simulated_registration import SimulatedRegistration
from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.registration.icp import find_border, register
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan, Pose2, Scan3D


class SiicpPlanner:
    """Simulated ICP (the paper): the smallest overlap whose registration meets epsilon."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose simulated error meets epsilon."""
        context, config = PlanningContext(session), session.config.planning
        if plan := termination_plan(context):
            return plan

        # Simulate what would be visible
        if config.virtual_scan == "visible":
            return plan_smallest_overlap(context, _simulate_visible(context, rng))

        # Simulate a displaced copy of Q
        etas = list_overlaps(config)
        motions = dict(zip(etas, sample_motion_noise(len(etas), config, rng), strict=True))
        noise = dict(zip(etas, rng.spawn(len(etas)), strict=True))
        return plan_smallest_overlap(
            context, lambda eta, O2: simulate_error(context, eta, O2, motions[eta], noise[eta])
        )


def _simulate_visible(
    context: PlanningContext, rng: np.random.Generator
) -> Callable[[float, Pose2], float]:
    """Return the error of a viewpoint by simulated registration of what would be seen there."""
    try:
        simulation = SimulatedRegistration.of(context, int(rng.integers(2**63)))
    except RegistrationError:
        return lambda eta, O2: math.inf
    return lambda eta, O2: simulation.error(O2, context.session.config.planning.trials)


def simulate_error(
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
    # Cut Q and Q' out
    config = context.session.config.planning
    n_Q = context.n_Q(overlap)
    Q = context.P.last_lines(n_Q)
    Q_prime = _select_surface(context, config).last_lines(n_Q)
    Q_prime = Q_prime.middle_lines(max(1, round(config.alpha * n_Q)))  # eq. (5)
    border = find_border(Q, right=not context.has_end_in_view)
    tree = Tree.of(Q.points)

    # Displace and register each draw
    errors = []
    for draw in draws:
        R_T = scale_motion_error(draw, viewpoint, config)  # eq. (2)
        N_noise = config.sigma * rng.standard_normal(Q_prime.points.shape)
        Q_virtual = R_T.apply(Q_prime.points) + N_noise  # eq. (6)
        result = register(
            Q.points,
            Q_virtual,
            border=border,
            config=context.session.config.registration,
            tree=tree,
        )
        errors.append(measure_error(result, R_T, Q_prime.points, Q_virtual, config.criterion))
    return float(np.quantile(errors, config.quantile, method="higher"))


def _select_surface(context: PlanningContext, config: PlanningConfig) -> Scan3D:
    """Return the points that are scanned virtually: those of P, with or without its noise.

    The noise of P is a texture that Q and a copy of it share, and two real scans do not: ICP would
    find it again on the barest wall.
    """
    if config.virtual_scan == "copy":
        return context.P
    return context.P.with_points_of(context.smoothed)
