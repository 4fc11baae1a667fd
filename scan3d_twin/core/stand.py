"""A stand: it sees the target from where it stands, and takes one view."""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.scanning.target.selection import find_target
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Plan, Pose2
from scan3d_twin.core.viewpoints import extract_panorama_contour

STAND_REASON = "a stand does not drive"
"""Why the loop of a stand ends after its view."""


def start_stand_session(
    panorama: Observation,
    here: Pose2,
    config: Config,
    seed: int,
    target: tuple[float, float] | None,
) -> Session:
    """Return an empty session of a stand, which sees the target from where it stands.

    Args and errors as for ``session_start.start_session``; every place is a viewpoint.
    """
    hint = find_target(panorama, target, config)
    contour = extract_panorama_contour(here.inverse().apply(hint))
    return Session(config, seed, hint, here.rotate(contour.normal(0)), ((0, panorama),))


class StandPlanner:
    """The planner of a stand: it stays where it is."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``: one view, and no other."""
        return Plan(None, 0.0, math.nan, False, (), STAND_REASON)
