"""A closed loop of which an error leaves the views taken so far: what several benchmarks run."""

from __future__ import annotations

import sys

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.session import Session


class Watcher(Unobserved):
    """Keeps the session as it was when something ended it."""

    session: Session | None = None

    def on_view(self, session: Session) -> None:
        """Remember ``session``."""
        self.session = session


def run_watched(
    name: str,
    robot: Robot,
    config: Config,
    seed: int,
    watcher: Watcher,
    planner: Planner | None = None,
) -> Session | None:
    """Return the session, up to where an error ended it; None if that was before the first view.

    The planner is that of ``config`` unless another is given. The error is printed, with the
    ``name`` of the run.
    """
    try:
        return run_loop(robot, planner or make_planner(config.planner), config, seed, watcher)
    except TwinError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return watcher.session
