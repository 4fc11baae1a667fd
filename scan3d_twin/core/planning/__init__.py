"""Viewpoint planners: one file each, behind the one ``Planner`` protocol."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.planning.fisher import FisherPlanner
from scan3d_twin.core.planning.siicp import SiicpPlanner
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan


class Planner(Protocol):
    """Decides where to scan next."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the next viewpoint, or a plan without one when the scan is finished.

        Pure: the same session and generator state give the same plan. The session has at least one
        view.
        """
        ...


_PLANNERS: dict[str, type[Planner]] = {"fisher": FisherPlanner, "siicp": SiicpPlanner}


def planner_names() -> tuple[str, ...]:
    """Return the names that ``make_planner`` knows."""
    return tuple(sorted(_PLANNERS))


def make_planner(name: str) -> Planner:
    """Return the planner called ``name``.

    Raises:
        UnknownNameError: There is none of this name.
    """
    if name not in _PLANNERS:
        raise UnknownNameError("planner", name, _PLANNERS)
    return _PLANNERS[name]()
