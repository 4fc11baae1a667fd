"""A session whose views have different headings, to be exported."""

import math

import numpy as np
import pytest
import synthetic
from paper import paper_config

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2


@pytest.fixture(scope="session")
def session() -> Session:
    """Two views of three boxes, taken from different headings."""
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session = Session(paper_config(), 7, hint, np.array([-1.0, 0.0]))
    for pose in (Pose2(-0.4, 0.2, 0.1), Pose2(-0.4, 0.0, -0.2)):
        session = integrate(session, synthetic.observe(pose))
        session = session.with_plan(Plan(Pose2(), 0.8, math.nan, True, (), "the default"))
    return session.with_stop_reason("enough")
