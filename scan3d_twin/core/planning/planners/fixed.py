"""Fixed planner: always the same overlap, as people do without a planner."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import plan_with_overlap
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan


class FixedPlanner:
    """The overlap `baselines.fixed_overlap`, always."""

    def __init__(self, overlap: float | None = None) -> None:
        """Set the overlap; None for ``config.baselines.fixed_overlap``."""
        self._overlap = overlap

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint for the fixed overlap."""
        context = PlanningContext(session)
        if plan := termination_plan(context):
            return plan
        overlap = self._overlap
        if overlap is None:
            overlap = session.config.baselines.fixed_overlap
        return plan_with_overlap(context, overlap, f"fixed overlap: {overlap:.0%}")


def fixed20() -> FixedPlanner:
    """An overlap of 20 %, always."""
    return FixedPlanner(0.2)


def fixed50() -> FixedPlanner:
    """An overlap of 50 %, always."""
    return FixedPlanner(0.5)


def fixed80() -> FixedPlanner:
    """An overlap of 80 %, always."""
    return FixedPlanner(0.8)
