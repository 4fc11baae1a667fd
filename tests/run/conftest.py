"""A session without a simulator for the tests of a run's report."""

import pytest
from sessions import two_planned_views

from scan3d_twin.core.session import Session


@pytest.fixture(scope="session")
def session() -> Session:
    """Two views of three boxes in closed form; the second planned without a prediction."""
    return two_planned_views()
