"""Fisher planner: the smallest overlap whose closed-form error prediction meets epsilon.

The prediction (``error_prediction``) needs no sampling and no registration, but does not notice
wrong basins. With ``planning.checks``, simulated registrations (``simulated_registration``) check
the overlap that it chooses; where they fail, the next larger overlap is tried.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import plan_smallest_overlap
from scan3d_twin.core.planning.prediction.error_prediction import (
    ErrorPrediction,
    predict_by_odometry,
)
from scan3d_twin.core.planning.prediction.simulated_registration import SimulatedRegistration
from scan3d_twin.core.planning.sweep_choice import narrow_sweep
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2


class FisherPlanner:
    """Closed form: the smallest overlap whose predicted covariance meets epsilon."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint with the smallest overlap whose predicted error meets epsilon."""
        context, config = PlanningContext(session), session.config.planning
        seed = int(rng.integers(2**63))

        # Prepare prediction and simulation
        try:
            prediction = ErrorPrediction.of(context)
        except RegistrationError:
            return termination_plan(context) or plan_smallest_overlap(
                context, lambda _, viewpoint: predict_by_odometry(context, viewpoint)
            )
        simulation = SimulatedRegistration(
            prediction.grid, prediction.on_target, session.config, seed, prediction.motion
        )

        def error(viewpoint: Pose2, half: float | None = None) -> float:
            predicted = prediction.error(viewpoint, half)
            if config.checks == 0 or predicted > config.epsilon:
                return predicted
            simulated = simulation.error(viewpoint, config.checks, half)
            return max(predicted, simulated) if simulated > config.epsilon else predicted

        # Choose the overlap, then the sector
        final = termination_plan(context, error)
        if final is not None and final.viewpoint is None:
            return final
        plan = final or plan_smallest_overlap(context, lambda _, viewpoint: error(viewpoint))
        return narrow_sweep(context, plan, error)
