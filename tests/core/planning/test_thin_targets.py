"""Targets that few lines of a sweep show."""

from __future__ import annotations

import math

import numpy as np
from paper import paper_config, paper_registration, paper_sweep
from synthetic import Box, observe

from scan3d_twin.core.config import Scope
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.prediction.error_prediction import (
    MIN_SHARED_SURFELS,
    ErrorPrediction,
)
from scan3d_twin.core.planning.prediction.simulated_registration import SimulatedRegistration
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2

THIN = (Box((0.98, -0.015, 0.0), (1.01, 0.015, 0.8)),)
THINNER = (Box((0.98, -0.008, 0.0), (0.996, 0.008, 0.3)),)


def view_of_it(
    heading: float, boxes: tuple[Box, ...] = THIN, *, scope: Scope = "target"
) -> PlanningContext:
    """Return the context after one view from 1 m, headed ``heading`` [rad] to its left."""
    sweep = paper_sweep(width=math.radians(40.0), margin=math.radians(15.0))
    registration = paper_registration(engine="grid", scope=scope)
    config = paper_config(sweep=sweep, registration=registration)
    session = Session(config, 0, np.array([[0.98, 0.0]]), np.array([-1.0, 0.0]))
    pose = Pose2(0.0, 0.0, heading)
    seen = observe(pose, boxes, room=scope == "sweep", width=math.radians(70.0))
    return PlanningContext(integrate(session, Observation(seen.image, pose)))


def test_a_pole_of_3_cm_is_in_sight() -> None:
    context = view_of_it(0.0)
    assert 2 <= context.n_lines <= 5
    assert context.termination_reason() is None


def test_it_is_also_in_sight_at_the_margin_of_a_sweep() -> None:
    context = view_of_it(math.radians(27.0))
    assert 2 <= context.n_lines <= 5
    assert context.termination_reason() is None


def test_it_is_lost_where_the_sweep_does_not_show_it() -> None:
    reason = view_of_it(math.radians(90.0)).termination_reason()
    assert reason is not None
    assert reason.startswith("target lost")


def test_where_the_room_fixes_the_next_view_a_pole_needs_no_surfels_of_its_own() -> None:
    """Two lines on a pole of 16 mm give no surfel, and so no shared ones."""
    prediction = ErrorPrediction.of(view_of_it(0.0, THINNER, scope="sweep"))
    on_pole = prediction.grid.index[prediction.on_target]
    assert len(on_pole) > 40
    assert np.count_nonzero(on_pole >= 0) < MIN_SHARED_SURFELS
    step = Pose2(0.05, -0.4, 0.4)
    assert 0.0 < prediction.error(step) < 0.020
    simulated = SimulatedRegistration(
        prediction.grid, prediction.on_target, prediction.config, seed=1
    )
    assert math.isfinite(simulated.error(step, 2))


def test_no_error_is_predicted_of_a_target_out_of_sight() -> None:
    prediction = ErrorPrediction.of(view_of_it(math.radians(90.0), THINNER, scope="sweep"))
    assert prediction.error(Pose2(0.05, -0.4, 0.4)) == math.inf
