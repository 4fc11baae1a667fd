"""The main loop: the flow chart of the paper's Fig. 5.

``observe`` touches the robot; ``integrate`` and ``planner.plan`` are pure, so that simulation, the
real robot, replay and tests all run the same algorithm.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Protocol

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.drive_to_viewpoint import drive
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.mapping.loop_closure import align_final, align_on_loop_closure
from scan3d_twin.core.mapping.scan_matching import match_to_previous
from scan3d_twin.core.navigation.costmap import Costmap, build_costmap
from scan3d_twin.core.observer import Observer, Unobserved
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.scanning.extrinsic_calibration import (
    calibrate_on_panorama,
    suspicion,
    with_turning,
)
from scan3d_twin.core.scanning.gap_filling import fill_gaps
from scan3d_twin.core.scanning.mixed_pixels import without_mixed_pixels
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.scanning.target_extraction import all_points, extract_target, find_target
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Plan,
    Pose2,
)
from scan3d_twin.core.viewpoints import (
    first_segment,
    panorama_contour,
    place,
    sweep_width,
)

REGISTRATION, PLANNING = 1, 2
"""Random streams of view k: ``default_rng([seed, k, stream])``; stream 0 is the sensor's."""
PAUSE = 0.1
"""Time between two looks at the pause button [s]."""
DEFAULT_CONFIG = Config()
"""The preset ``best``."""


def digitize(
    robot: Robot,
    config: Config = DEFAULT_CONFIG,
    *,
    seed: int = 0,
    observer: Observer | None = None,
    target: tuple[float, float] | None = None,
) -> Session:
    """Digitise a target: take a panorama, then observe, integrate, plan and move until it is done.

    Args:
        robot: Open and at rest.
        config: What to do; it names the planner.
        seed: The run's one seed.
        observer: Sees every step, and can pause and stop the run; None where nobody watches.
        target: Place (x, y) in ``odom`` [m] of the target; the most salient thing by default.

    Returns:
        The session, with the reason why it ended.

    Raises:
        ConfigError: There is no such planner, or it needs the truth.
        SceneError: There is no target.
        ScanError, HazardError, LinkError: From the robot; the wheels are stopped, and the observer
            has seen all finished views.

    >>> with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
    ...     session = s3d.digitize(robot, s3d.Config(max_views=1))
    >>> len(session.views), session.stop_reason
    (1, 'max_views: 1 views taken')
    """
    planner = make_planner(config.planner)
    return run_loop(robot, planner, config, seed, observer or Unobserved(), target)


def run_loop(
    robot: Robot,
    planner: Planner,
    config: Config,
    seed: int,
    observer: Observer,
    target: tuple[float, float] | None = None,
    earlier: Session | None = None,
) -> Session:
    """Run the loop of ``digitize`` with a ``planner``, from the start or an earlier session on.

    Args:
        robot: Open and at rest.
        planner: Decides on the viewpoints.
        config: The effective configuration.
        seed: The run's one seed.
        observer: Sees every step.
        target: Place (x, y) in ``odom`` [m] of the target; the most salient thing by default.
        earlier: A session of this robot to go on from, by ``config``: it plans again after the
            latest view. Its odometry must have gone on since.

    Returns:
        The session, with the reason why it ended.

    Raises:
        SceneError: There is no target.
        ScanError, HazardError, LinkError: From the robot; the wheels are stopped, and the observer
            has seen all finished views.
    """
    scout = _Watched(robot, observer)
    if earlier is None:
        loop = views(scout, *begin(robot, config, seed, observer, target))
    else:
        loop = views(scout, unplanned(replace(earlier, config=config_for(earlier, config))), None)
    known = 0 if earlier is None else len(earlier.views)
    session = next(loop)
    while True:
        if len(session.views) > known:
            observer.on_view(session)
        session, plan = _plan(planner, session, loop)
        planned = session.with_plan(plan)
        observer.on_plan(planned)
        if plan.viewpoint is None or not _go_on(robot, observer):
            break
        session = loop.send(plan)
    reason = plan.reason if plan.viewpoint is None else "stopped by the user"
    return conclude(planned, observer).ended(reason)


class ScanSource(Protocol):
    """Takes the images that the loop asks for, by whatever means."""

    def look(self, session: Session) -> Observation:
        """Return a look around from where the robot stands."""
        ...

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """Go to ``viewpoint`` in ``odom`` and return a sweep from there."""
        ...


def unplanned(session: Session) -> Session:
    """Return ``session`` as it was when its latest view had been taken and no plan made yet."""
    return replace(session, plans=session.plans[: max(0, len(session.views) - 1)], stop_reason="")


def views(
    scout: ScanSource, session: Session, viewpoint: Pose2 | None
) -> Generator[Session, Plan, None]:
    """The loop of Fig. 5, the decisions left open: yield the session after each view, take a plan.

    A plan that needs a look gets the session with it, and another plan is due. The loop has no end:
    whoever drives it stops when a plan has no viewpoint.

    Args:
        scout: Takes the sweeps and looks.
        session: So far, as ``begin`` returns it.
        viewpoint: The next one in ``odom``; None when a plan is due after the latest view.
    """
    while True:
        if viewpoint is not None:
            session = integrate(session, scout.observe(viewpoint, session))
        plan = yield session
        if plan.needs_panorama:
            session = session.with_panorama(scout.look(session))
            plan = yield session
        session = session.with_plan(plan)
        viewpoint = _in_odom(session, plan)


class _Watched:
    """The scout that drives a robot while an observer watches."""

    def __init__(self, robot: Robot, observer: Observer) -> None:
        self._robot, self._observer = robot, observer

    def look(self, session: Session) -> Observation:
        """See ``ScanSource``."""
        self._observer.on_event("looking around for free space")
        return take_panorama(self._robot, session.config, self._observer.on_line)

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """See ``ScanSource``."""
        return observe(self._robot, viewpoint, session, self._observer)


def begin(
    robot: Robot,
    config: Config,
    seed: int,
    observer: Observer,
    target: tuple[float, float] | None,
) -> tuple[Session, Pose2]:
    """Look around for the target; return an empty session and the first viewpoint in ``odom``."""
    observer.on_event("looking around for the target")
    look = take_panorama(robot, config, observer.on_line)
    found = calibrate_on_panorama(look.image)
    if warning := suspicion(found):
        observer.on_event(f"warning: {warning}")
    tuned = with_turning(config, found)
    if tuned != config:
        observer.on_event(f"turns are corrected by {tuned.mount.yaw_scale:+.2%}")
    return start(look, robot.base.odometry().T_odom_base, tuned, seed, target)


def config_for(session: Session, config: Config) -> Config:
    """Return ``config`` as a run has it that goes on from ``session``: by its first look around."""
    return with_turning(config, calibrate_on_panorama(session.panoramas[0][1].image))


def start(
    look: Observation,
    here: Pose2,
    config: Config,
    seed: int,
    target: tuple[float, float] | None,
) -> tuple[Session, Pose2]:
    """Return an empty session and the first viewpoint in ``odom``, from a look around.

    Pure, as ``integrate``. The robot stands ``here`` in ``odom``.
    """
    hint = find_target(look, target, config)
    contour = panorama_contour(here.inverse().apply(hint))
    session = Session(config, seed, hint, here.rotate(contour.normal(0)), ((0, look),))
    costmap = build_costmap(session.observations(), config, here)
    segment = first_segment(contour, sweep_width(config), from_left=config.tour == "front")

    def feasible(viewpoint: Pose2) -> bool:
        there = here @ viewpoint
        return costmap.feasible(there.x, there.y)

    viewpoint, _ = place(segment, config, feasible)
    if viewpoint is None:
        raise ScanError(
            "no viewpoint of the target can be reached; clear the floor in front of it, or allow "
            "another planning.standoff"
        )
    return session, here @ viewpoint


def observe(robot: Robot, viewpoint: Pose2, session: Session, observer: Observer) -> Observation:
    """Drive to ``viewpoint`` in ``odom``, around obstacles seen and felt, and sweep there."""
    observer.on_event(f"driving to viewpoint {len(session.views)}")
    touched = drive(robot, viewpoint, session, observer)
    observer.on_event(f"scanning view {len(session.views)}")
    observation = sweep(robot, viewpoint.yaw, session.config, observer.on_line)
    return replace(observation, touched=touched)


def find_path(costmap: Costmap, viewpoint: Pose2) -> FloatArray:
    """Return the waypoints (n, 2) in ``odom`` [m] to ``viewpoint``, around obstacles."""
    path = costmap.path(viewpoint.x, viewpoint.y)
    if path is None:
        raise ScanError(f"no way to the viewpoint at ({viewpoint.x:.2f}, {viewpoint.y:.2f}) m")
    return path


def integrate(session: Session, observation: Observation) -> Session:
    """Clean the image, extract the target, register with the previous view and append the new one.

    Pure: the same session and observation give the same result.
    """
    config = session.config
    image = without_mixed_pixels(observation.image, config.gaps)
    image = fill_gaps(image, config.gaps)
    points = all_points(image, config)
    prior = _prior(session, observation)
    known = prior.inverse().apply(_known_target(session))
    target = extract_target(image, points, known, config.target)
    view = View(observation, image, target, points, prior, None)
    if session.views:
        view = match_to_previous(view, session.views, config)
    return align_on_loop_closure(session.with_view(view))


def conclude(session: Session, observer: Observer) -> Session:
    """Return a finished session with its views aligned, if wanted; tell which do not fit."""
    result = align_final(session)
    if len(result.views) < len(session.views):
        observer.on_event(
            f"left out {len(session.views) - len(result.views)} views that do not fit"
        )
    for k in result.misfits:
        observer.on_event(f"view {k} does not fit the others")
    return result


def _prior(session: Session, observation: Observation) -> Pose2:
    """Return ``T_world_scan`` by odometry from the previous view; world is odom at the first."""
    if not session.views:
        return observation.T_odom_scan
    previous = session.views[-1]
    move = previous.observation.T_odom_scan.inverse() @ observation.T_odom_scan
    return previous.T_world_scan @ move


def _known_target(session: Session) -> FloatArray:
    """Return the top view (n, 2) in ``world`` of all that is known of the target."""
    seen = [view.T_world_scan.apply(view.target.points[:, :2]) for view in session.views]
    return np.concatenate([session.hint, *seen])


def _plan(
    planner: Planner, session: Session, loop: Generator[Session, Plan, None]
) -> tuple[Session, Plan]:
    """Plan; if the way is not known to be free, look around once and plan again."""
    plan = ask(planner, session)
    if plan.needs_panorama:
        session = loop.send(plan)
        plan = ask(planner, session)
    return session, plan


def ask(planner: Planner, session: Session) -> Plan:
    """Return what ``planner`` wants after the latest view, by the run's own chance."""
    rng = np.random.default_rng([session.seed, len(session.views) - 1, PLANNING])
    return planner.plan(session, rng)


def _in_odom(session: Session, plan: Plan) -> Pose2:
    """Return the planned viewpoint in ``odom``, relative to the latest view: drift cancels."""
    if plan.viewpoint is None:
        raise ScanError("a plan without a viewpoint ends the run")
    view = session.views[-1]
    return view.observation.T_odom_scan @ view.T_world_scan.inverse() @ plan.viewpoint


def _go_on(robot: Robot, observer: Observer) -> bool:
    """Wait while the user pauses; tell whether to go on."""
    while (command := observer.command()) == "pause":
        robot.clock.sleep(PAUSE)
    return command == "go"
