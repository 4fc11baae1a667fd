"""A session to be shown."""

import math

import numpy as np
import pytest
import synthetic
from paper import paper_config

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Candidate, Plan, Pose2

HINT = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])


def plan(overlap, errors, *, fell_back=False, last=False):
    """Return a plan that tried 20 %, 40 %, ... with ``errors`` [m]."""
    there = Pose2(-0.4, -0.3, 0.0)
    candidates = tuple(
        Candidate(there, round(0.2 * (k + 1), 9), error, True) for k, error in enumerate(errors)
    )
    chosen = next((c.predicted_rmse for c in candidates if c.overlap == overlap), math.nan)
    return Plan(None if last else there, overlap, chosen, fell_back, candidates, "for a test")


@pytest.fixture(scope="session")
def session() -> Session:
    """Three noisy views of three boxes; one planned at once, one by default, the last one ends."""
    rng = np.random.default_rng(0)
    session = Session(paper_config(), 7, HINT, np.array([-1.0, 0.0]))
    plans = [
        plan(0.6, [0.012, 0.011, 0.008]),
        plan(0.8, [math.inf, 0.090, 0.030, 0.015], fell_back=True),
        plan(0.0, [], last=True),
    ]
    for y, each in zip((0.6, 0.1, -0.5), plans, strict=True):
        seen = synthetic.observe(Pose2(-0.4, y, 0.0), sigma=0.004, rng=rng)
        session = integrate(session, seen).with_plan(each)
    return session.with_stop_reason("front complete")
