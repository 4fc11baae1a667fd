"""What a run knows so far: an immutable record that every pure function reads."""

from __future__ import annotations

from dataclasses import dataclass, replace

from scan3d_twin import __version__
from scan3d_twin.core.config import Config
from scan3d_twin.core.options import renamed
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Plan,
    Pose2,
    RangeImage,
    RegistrationResult,
    Scan3D,
)


@dataclass(frozen=True)
class View:
    """One sweep placed in the world.

    Attributes:
        observation: As it came from the robot.
        image: Its range image with the gaps filled (section 4.1).
        target: The target's points in ``scan`` (section 4.2).
        sweep: All points in ``scan`` except the floor.
        T_world_scan: Where registration put the scan.
        registration: Against the previous view; None for the first.

    >>> view = session.views[1]
    >>> points_in_world = view.T_world_scan.apply(view.target.points)
    >>> points_in_world.shape == view.target.points.shape
    True
    """

    observation: Observation
    image: RangeImage
    target: Scan3D
    sweep: Scan3D
    T_world_scan: Pose2
    registration: RegistrationResult | None

    def compress(self) -> None:
        """Put the large arrays away: earlier views are kept, but seldom read."""
        self.sweep.compress(self.image)
        self.image.compress(self.observation.image)


@dataclass(frozen=True)
class Session:
    """All views and plans of a run.

    ``world`` is the odometry frame as it was at the first view.

    Attributes:
        config: The effective configuration.
        seed: The run's one seed.
        hint: Top-view points (n, 2) of the target in ``odom``, found by the look around [m].
        front: Outward unit normal (2,) in ``world`` of the target as the robot first saw it.
        panoramas: Coarse sweeps all round, each with the number of views taken before it.
        views: In the order they were taken.
        plans: ``plans[k]`` was made after ``views[k]``.
        misfits: Views that contradict most others, by the latest alignment.
        stop_reason: Why the run ended; empty while it goes on.
        version: Of the software.

    >>> len(session.views), session.seed, session.config.planner
    (2, 0, 'fisher')
    """

    config: Config
    seed: int
    hint: FloatArray
    front: FloatArray
    panoramas: tuple[tuple[int, Observation], ...] = renamed((), "looks")
    views: tuple[View, ...] = ()
    plans: tuple[Plan, ...] = ()
    misfits: tuple[int, ...] = ()
    stop_reason: str = ""
    version: str = __version__

    def with_view(self, view: View) -> Session:
        """Return a session with ``view`` appended."""
        return replace(self, views=(*self.views, view))

    def with_panorama(self, look: Observation) -> Session:
        """Return a session with a look around from the latest viewpoint appended."""
        return replace(self, panoramas=(*self.panoramas, (len(self.views), look)))

    def with_plan(self, plan: Plan) -> Session:
        """Return a session with ``plan`` appended."""
        return replace(self, plans=(*self.plans, plan))

    def ended(self, reason: str) -> Session:
        """Return a session that ended for ``reason``."""
        return replace(self, stop_reason=reason)

    def compress(self) -> None:
        """Put the large arrays of all but the latest view away; everything reads as before."""
        for _, look in self.panoramas:
            look.image.compress()
        for view in self.views[:-1]:
            view.compress()

    def observations(self) -> tuple[Observation, ...]:
        """Return all looks around and sweeps in the order in which they were taken."""
        result: list[Observation] = []
        for k in range(len(self.views) + 1):
            result += [look for taken, look in self.panoramas if taken == k]
            result += [view.observation for view in self.views[k : k + 1]]
        return tuple(result)
