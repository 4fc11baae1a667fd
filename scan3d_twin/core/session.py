"""The session: an immutable record of all views and plans of a run."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

from scan3d_twin import __version__
from scan3d_twin.core.config import Config
from scan3d_twin.core.display import render_html
from scan3d_twin.core.options import renamed
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Plan,
    Pose2,
    RangeImage,
    RegistrationResult,
    Scan3D,
    read_only,
)

YAW_SCALE_REPEATABILITY = 0.001
"""Standard deviation of the yaw scale of a sweep from that of other sweeps of its base; twice the
0.0005 of the first sweeps of random:20000 to random:20039 from their panoramas (0.0006 by
benchmarks/mount.py in three_boxes)."""


class Workspace:
    """The cache of one run, handed along with its session.

    It saves time where the same image is asked again, and changes no result. What was computed of
    an image is forgotten with the image; a session that is pickled takes an empty workspace along.
    """

    def __init__(self) -> None:
        self._results: WeakKeyDictionary[RangeImage, dict[Hashable, Any]] = WeakKeyDictionary()

    def results_of(self, image: RangeImage) -> dict[Hashable, Any]:
        """Return what was computed of ``image`` so far, by a key of whoever computed it.

        The results must not refer to the image, or neither is ever freed.
        """
        return self._results.setdefault(image, {})

    def __reduce__(self) -> tuple[type[Workspace], tuple[()]]:
        return Workspace, ()


@dataclass(frozen=True, slots=True)
class TurnScale:
    """What a base turns more than its odometry says, as the registrations of a run have shown.

    Attributes:
        scale: The excess as a share of the turn.
        sigma: Its standard deviation.
    """

    scale: float
    sigma: float

    def correct(self, image: RangeImage) -> RangeImage:
        """Return the ``image`` of a sweep of this base with its yaws corrected."""
        return replace(image, yaws=read_only(image.yaws * (1.0 + self.scale)))


@dataclass(frozen=True, eq=False)
class View:
    """A keyframe: one sweep with its pose in the world.

    Attributes:
        observation: The sweep as it came from the robot.
        image: Its range image with the gaps filled (section 4.1).
        target: The target's points in ``scan`` (section 4.2).
        sweep: All points in ``scan`` except the floor.
        T_world_scan: Pose of the scan, by registration.
        registration: Result of registering it on the previous view; None for the first view.
        turns: Correction of the turns in ``image``, ``target`` and ``sweep``; None where the run
            has not learned any.

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
    turns: TurnScale | None = None

    @property
    def measured_image(self) -> RangeImage:
        """The range image as measured, its gaps open, with the turns corrected."""
        image = self.observation.image
        return image if self.turns is None else self.turns.correct(image)

    @property
    def T_world_odom(self) -> Pose2:
        """Where registration puts the odometry frame of the time of this view: it drifts."""
        return self.T_world_scan @ self.observation.T_odom_scan.inverse()

    def with_turns(self, turns: TurnScale) -> View:
        """Return the view with another correction of its turns, at the same pose."""
        image = replace(self.image, yaws=turns.correct(self.observation.image).yaws)
        target, sweep = self.target.with_points_of(image), self.sweep.with_points_of(image)
        return replace(self, image=image, target=target, sweep=sweep, turns=turns)

    def compress(self) -> None:
        """Compress the large arrays, as earlier views are seldom read."""
        self.sweep.compress(self.image)
        self.image.compress(self.observation.image)


@dataclass(frozen=True, eq=False)
class Session:
    """All views and plans of a run.

    Frame ``world`` is the odometry frame as it was at the first view.

    Attributes:
        config: The effective configuration.
        seed: The one seed of the run.
        hint: Top-view points (n, 2) of the target in ``odom``, from the first panorama [m].
        front: Outward unit normal (2,) in ``world`` of the target as the robot first saw it.
        panoramas: Coarse sweeps of a full turn, each with the number of views taken before it.
        views: The views in the order in which they were taken.
        plans: ``plans[k]`` was made after ``views[k]``.
        misfits: Indices of the views that contradict most others, by the latest alignment.
        stop_reason: Why the run ended; empty while it goes on.
        version: Version of the software.
        workspace: Results of the images that are needed again; no part of the value.

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
    workspace: Workspace = field(
        default_factory=Workspace, compare=False, repr=False, metadata={"stored": False}
    )

    def __repr__(self) -> str:
        return f"<Session of {len(self.views)} views: {self.stop_reason or 'not ended'}>"

    def _repr_html_(self) -> str | None:
        return render_html(self)

    def with_view(self, view: View) -> Session:
        """Return a session with ``view`` appended; all views take what it knows of the turns."""
        turns, views = view.turns, self.views
        if turns is not None:
            views = tuple(v if v.turns == turns else v.with_turns(turns) for v in views)
        return replace(self, views=(*views, view))

    def with_panorama(self, panorama: Observation) -> Session:
        """Return a session with a panorama from the latest viewpoint appended."""
        return replace(self, panoramas=(*self.panoramas, (len(self.views), panorama)))

    def with_plan(self, plan: Plan) -> Session:
        """Return a session with ``plan`` appended."""
        return replace(self, plans=(*self.plans, plan))

    def with_stop_reason(self, reason: str) -> Session:
        """Return the session of a run that ended for ``reason``."""
        return replace(self, stop_reason=reason)

    def compress(self) -> None:
        """Compress the large arrays of all but the latest view; everything reads as before."""
        for _, panorama in self.panoramas:
            panorama.image.compress()
        for view in self.views[:-1]:
            view.compress()

    def observations(self) -> tuple[Observation, ...]:
        """Return all panoramas and sweeps in the order in which they were taken.

        Each has the pose that registration gives it in ``odom`` as it is at the latest view: by
        odometry alone what was seen long ago would lie where it no longer is.
        """
        result: list[Observation] = []
        for k in range(len(self.views) + 1):
            seen = [panorama for taken, panorama in self.panoramas if taken == k]
            anchor = max(0, k - 1)
            result += [self._placed(panorama, anchor) for panorama in seen]
            result += [self._placed(view.observation, k) for view in self.views[k : k + 1]]
        return tuple(result)

    def _placed(self, observation: Observation, k: int) -> Observation:
        """Return an observation made in ``odom`` of view k in that of the latest view."""
        if k >= len(self.views) - 1:
            return observation
        latest = self.views[-1].T_world_odom
        return observation.moved(latest.inverse() @ self.views[k].T_world_odom)
