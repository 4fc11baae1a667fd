"""The main loop: the flow chart of the paper's Fig. 5.

Only ``observe`` touches the robot; ``integrate`` and ``planner.plan`` are pure functions, so that
simulation, the real robot, replay and tests all run the same algorithm.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Protocol

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.drive_to_viewpoint import drive
from scan3d_twin.core.errors import ConfigError, ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.mapping.loop_closure import align_final, align_on_loop_closure
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.scan_matching import match_to_previous, predict_pose
from scan3d_twin.core.navigation.legs import measure_legs
from scan3d_twin.core.observer import Observer, Unobserved
from scan3d_twin.core.placed_views import integrate_placed
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.planning.overlap_or_default import describe_shortfall
from scan3d_twin.core.planning.sweep_choice import choose_sector
from scan3d_twin.core.scanning.gap_filling import fill_gaps
from scan3d_twin.core.scanning.mixed_pixels import remove_mixed_pixels
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.scanning.target.extraction import extract_points, extract_target
from scan3d_twin.core.scanning.upright import make_upright
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.session_start import begin_session, tune_config
from scan3d_twin.core.stand import StandPlanner
from scan3d_twin.core.target_growth import extend_targets
from scan3d_twin.core.types import Observation, Plan, Pose2

DEFAULT_CONFIG = Config()
"""The preset ``best``."""
PLANNING_STREAM = 2
"""Random stream of planning: view k draws from ``default_rng([seed, k, stream])``; stream 0 belongs
to the sensor and the motion, stream 1 to registration."""
PAUSE_PERIOD = 0.1
"""Period at which a paused run asks for the next command [s]."""


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
        ConfigError: There is no such planner, it needs the truth, or the seed is negative.
        SceneError: There is no target.
        ScanError, HazardError, LinkError: From the robot; the wheels are stopped, and the observer
            has seen all finished views.

    >>> with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
    ...     session = s3d.digitize(robot, s3d.Config(max_views=1))
    >>> len(session.views), session.stop_reason
    (1, '1 view taken (max_views)')
    """
    if seed < 0:
        raise ConfigError(f"seed must be >= 0, got {seed}")
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
    scout = _WatchedRobot(robot, observer)
    if robot.base.spec.is_stand:
        planner = StandPlanner()
    if earlier is None:
        loop = iterate_views(scout, *begin_session(robot, config, seed, observer, target))
    else:
        loop = iterate_views(
            scout, drop_latest_plan(replace(earlier, config=tune_config(earlier, config))), None
        )
    known = 0 if earlier is None else len(earlier.views)
    session = next(loop)
    while True:
        if len(session.views) > known:
            observer.on_view(session)
        session, plan = _plan(planner, session, loop)
        planned = session.with_plan(plan)
        observer.on_plan(planned)
        if plan.viewpoint is None or not _wait_while_paused(robot, observer):
            break
        if shortfall := describe_shortfall(plan, session.config.planning.epsilon):
            observer.on_event(f"warning: {shortfall} for view {len(session.views)}")
        session = loop.send(plan)
    reason = plan.reason if plan.viewpoint is None else "stopped by the user"
    return conclude_session(planned, observer).with_stop_reason(reason)


class ScanSource(Protocol):
    """The source of the sweeps and panoramas of the loop: a robot, a twin or a recording."""

    def take_panorama(self, session: Session) -> Observation:
        """Return a panorama from where the robot stands."""
        ...

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """Go to ``viewpoint`` in ``odom`` and return a sweep from there."""
        ...


def drop_latest_plan(session: Session) -> Session:
    """Return ``session`` as it was right after its latest view, before the plan that followed."""
    return replace(session, plans=session.plans[: max(0, len(session.views) - 1)], stop_reason="")


def iterate_views(
    scout: ScanSource, session: Session, viewpoint: Pose2 | None
) -> Generator[Session, Plan, None]:
    """Run the loop of Fig. 5 with the decisions left to the caller, who sends plans to it.

    It yields the session after each view and expects a plan. After a plan that needs a panorama it
    yields the session with the panorama and expects another plan. The loop has no end: the caller
    stops when a plan has no viewpoint.

    Args:
        scout: Takes the sweeps and panoramas.
        session: The session at the start, as ``begin_session`` returns it.
        viewpoint: The next viewpoint in ``odom``; None when a plan is due after the latest view.
    """
    while True:
        if viewpoint is not None:
            session = integrate(session, scout.observe(viewpoint, session))
        plan = yield session
        if plan.needs_panorama:
            session = session.with_panorama(scout.take_panorama(session))
            plan = yield session
        session = session.with_plan(plan)
        viewpoint = _to_odom(session, plan)


class _WatchedRobot:
    """The scan source that drives a robot while an observer watches."""

    def __init__(self, robot: Robot, observer: Observer) -> None:
        self._robot, self._observer = robot, observer

    def take_panorama(self, session: Session) -> Observation:
        """See ``ScanSource``."""
        self._observer.on_event("looking around for free space")
        return take_panorama(self._robot, session.config, self._observer.on_line)

    def observe(self, viewpoint: Pose2, session: Session) -> Observation:
        """See ``ScanSource``."""
        return observe(self._robot, viewpoint, session, self._observer)


def observe(robot: Robot, viewpoint: Pose2, session: Session, observer: Observer) -> Observation:
    """Drive to ``viewpoint`` in ``odom``, around obstacles, and return a sweep from there."""
    # Drive and sweep
    started = robot.clock.now()
    touched: tuple[tuple[float, float], ...] = ()
    if not robot.base.spec.is_stand:
        observer.on_event(f"driving to viewpoint {len(session.views)}")
        touched = drive(robot, viewpoint, session, observer)
    observer.on_event(f"scanning view {len(session.views)}")
    sector = choose_sector(session, viewpoint)
    observation = sweep(robot, viewpoint.yaw, session.config, observer.on_line, *sector)

    # Keep how the wheels moved since the latest view
    poses = [sample.T_odom_base for sample in robot.base.odometry_since(started)]
    before = session.views[-1].observation.T_odom_scan if session.views else poses[0]
    legs = measure_legs(before, poses, observation.T_odom_scan.yaw)
    return replace(observation, touched=touched, legs=legs)


def integrate(session: Session, observation: Observation) -> Session:
    """Return ``session`` with the view that ``observation`` makes, aligned on loop closure.

    Pure: the same session and observation give the same result. A view without odometry is placed
    by ``integrate_placed``.
    """
    # Place the lines of a tilted axis on an upright grid
    config, upright = session.config, make_upright(observation.image)
    if upright is not observation.image:
        observation = replace(observation, image=upright)
    if not observation.has_odometry:
        return integrate_placed(session, observation)

    # Clean the range image
    turns = session.views[-1].turns if session.views else None
    image = observation.image if turns is None else turns.correct(observation.image)
    image = remove_mixed_pixels(image, config.gaps)
    image = fill_gaps(image, config.gaps)

    # Predict by odometry
    motion = MotionModel.of(session.views, config, session.workspace)
    prior = predict_pose(session.views, observation, motion)

    # Extract the target
    points = extract_points(image, config)
    known = prior.inverse().apply(session.gather_known_target())
    target = extract_target(image, points, known, config.target)

    # Register on the previous view
    view = View(observation, image, target, points, prior, None, turns)
    if session.views:
        view = match_to_previous(view, session.views, config, motion, session.workspace)
    return align_on_loop_closure(extend_targets(session.with_view(view)))


def conclude_session(session: Session, observer: Observer) -> Session:
    """Return a finished session with its views aligned, if wanted; report those that do not fit."""
    result = align_final(session)
    if len(result.views) < len(session.views):
        observer.on_event(
            f"left out {len(session.views) - len(result.views)} views that do not fit"
        )
    for k in result.misfits:
        observer.on_event(f"view {k} does not fit the others")
    return result


def _plan(
    planner: Planner, session: Session, loop: Generator[Session, Plan, None]
) -> tuple[Session, Plan]:
    """Return the session and the plan; a plan that needs a panorama is made again with it."""
    plan = ask_planner(planner, session)
    if plan.needs_panorama:
        session = loop.send(plan)
        plan = ask_planner(planner, session)
    return session, plan


def ask_planner(planner: Planner, session: Session) -> Plan:
    """Return the plan of ``planner`` after the latest view, with the run's random stream."""
    rng = np.random.default_rng([session.seed, len(session.views) - 1, PLANNING_STREAM])
    return planner.plan(session, rng)


def _to_odom(session: Session, plan: Plan) -> Pose2:
    """Return the planned viewpoint in ``odom``, by the latest view so that drift cancels."""
    if plan.viewpoint is None:
        raise ScanError("a plan without a viewpoint ends the run")
    view = session.views[-1]
    return view.observation.T_odom_scan @ view.T_world_scan.inverse() @ plan.viewpoint


def _wait_while_paused(robot: Robot, observer: Observer) -> bool:
    """Wait while the user pauses; return whether to go on."""
    while (command := observer.command()) == "pause":
        robot.clock.sleep(PAUSE_PERIOD)
    return command == "go"
