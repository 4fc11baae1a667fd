"""Random planner: a viewpoint drawn at random, which any planner should beat."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import stop_plan
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan


class RandomPlanner:
    """Any feasible viewpoint around the target, drawn at random."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return a candidate drawn by ``rng``, while one of them would show something new."""
        candidates = PoseCandidates.of(session)
        if reason := candidates.termination_reason():
            return stop_plan(reason)
        if not candidates.worthwhile:
            return candidates.nothing_new()
        drawn = candidates.poses[int(rng.integers(len(candidates.poses)))]
        return candidates.go(
            drawn, f"one of {len(candidates.poses)} feasible viewpoints, at random"
        )
