"""Targets that few lines of a sweep show."""

from __future__ import annotations

import math

import numpy as np
from paper import paper_config, paper_sweep
from synthetic import Box, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2

THIN = (Box((0.98, -0.015, 0.0), (1.01, 0.015, 0.8)),)


def view_of_it(heading: float) -> PlanningContext:
    """Return the context after one view from 1 m, headed ``heading`` [rad] to its left."""
    sweep = paper_sweep(width=math.radians(40.0), margin=math.radians(15.0))
    session = Session(paper_config(sweep=sweep), 0, np.array([[0.98, 0.0]]), np.array([-1.0, 0.0]))
    pose = Pose2(0.0, 0.0, heading)
    seen = observe(pose, THIN, room=False, width=math.radians(70.0))
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
