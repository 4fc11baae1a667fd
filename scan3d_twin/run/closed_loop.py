"""One closed loop with an open robot: what ``twin sim``, ``twin real`` and ``twin bench`` share."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.hal import DriveBase, Robot
from scan3d_twin.core.model import truth
from scan3d_twin.core.navigation.motion_control import measure_travel
from scan3d_twin.core.observer import Observer, Observers, Unobserved
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, ScanLine
from scan3d_twin.run.report import Journey, thin_track
from scan3d_twin.run.settings import NAME_OR_PLACE, Settings, parse_place

MIN_NAMED_GAP = 0.5
"""Shortest time of computing that a run names [s]: from then on the driver of the base discards
what has arrived meanwhile."""

Timer = Callable[[], float]
"""Returns the computer's time [s] since some moment."""


class Truth(truth.Truth, Protocol):
    """The ground truth of the twin, which also knows its targets by name."""

    def locate_shown(self, name: str) -> tuple[float, float]:
        """Return the place (x, y) in ``odom`` [m] of the target ``name``."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired or guessed of the scene, in sentences."""
        ...


RobotContext = AbstractContextManager[tuple[Robot, Truth | None]]
"""Opens a robot, with the ground truth where there is one."""


@dataclass(frozen=True)
class LoopOutcome:
    """The result of a closed loop.

    Attributes:
        session: All views and plans up to the end.
        journey: Path, turns and duration of the whole run.
        journeys: The same by the end of each view.
        plan_times: Time the planner took after each view, by the timer [s].
        ended: The error that ended the loop early; None when the planner ended it.
    """

    session: Session
    journey: Journey
    journeys: tuple[Journey, ...]
    plan_times: tuple[float, ...]
    ended: BaseException | None


@dataclass(frozen=True)
class EarlierRun:
    """The finished part of a run that is resumed.

    Attributes:
        session: Its views and plans.
        journey: Path, turns and duration up to here.
    """

    session: Session
    journey: Journey


def close_loop(
    robot: Robot,
    truth: Truth | None,
    settings: Settings,
    observer: Observer,
    timer: Timer,
    earlier: EarlierRun | None = None,
    begun: float = 0.0,
) -> LoopOutcome:
    """Digitise with an open robot and return the result, also of a loop that an error ended.

    Args:
        robot: Open and at rest.
        truth: Finds a target by name; None where there is no ground truth.
        settings: The effective settings.
        observer: Sees every step.
        timer: Times the planner.
        earlier: The run to resume; None for a new one.
        begun: Start of a new run on the robot's clock [s].

    Raises:
        BaseException: Whatever ended the loop before its first view.
    """
    # Prepare planner, log and target
    planner = TimedPlanner(make_planner(settings.config.planner, truth), timer)
    log = _ProgressLog(robot, earlier, begun)
    watch = ComputingWatch(robot, observer)
    target = _find_target(settings.run.target, truth)

    # Digitise until it ends
    ended: BaseException | None = None
    try:
        session = run_loop(
            robot,
            planner,
            settings.config,
            settings.run.seed,
            Observers(log, watch, observer),
            target,
            None if earlier is None else earlier.session,
        )
    except BaseException as error:
        if log.session is None:
            raise
        ended, session = error, log.session.with_stop_reason(_describe_error(error))

    # Return the result
    return LoopOutcome(session, log.journey(), tuple(log.journeys), tuple(planner.seconds), ended)


class TimedPlanner:
    """A planner that measures how long it computes after each view [s]."""

    def __init__(self, planner: Planner, timer: Timer) -> None:
        self.seconds: list[float] = []
        self._planner = planner
        self._timer = timer

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``; the times of two calls for one view add up."""
        started = self._timer()
        self.seconds += [0.0] * (len(session.views) - len(self.seconds))
        try:
            return self._planner.plan(session, rng)
        finally:
            self.seconds[-1] += self._timer() - started


class ComputingWatch(Unobserved):
    """Names the times in which the program computed and read neither device.

    Only the robot's clock counts, on which computing takes no time in the twin.
    """

    def __init__(self, robot: Robot, observer: Observer) -> None:
        self._clock, self._base, self._observer = robot.clock, robot.base, observer
        self._read_at = robot.clock.now()

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``: the devices are read."""
        self._read_at = self._clock.now()

    def on_view(self, session: Session) -> None:
        """See ``Observer``: the latest scan has been registered."""
        self._name_gap(f"registering view {len(session.views) - 1}")

    def on_plan(self, session: Session) -> None:
        """See ``Observer``: the next viewpoint has been planned."""
        self._name_gap(f"planning after view {len(session.views) - 1}")

    def _name_gap(self, what: str) -> None:
        before = max(self._read_at, self._base.odometry().stamp)
        self._read_at = self._clock.now()
        gap = self._read_at - before
        if gap >= MIN_NAMED_GAP:
            self._observer.on_event(f"{what} took {gap:.1f} s, in which no device was read")


class JourneyMeter:
    """Adds up path and turns of a base; read it before the base discards its odometry.

    Counts from the moment the base was opened, or continues an ``earlier`` journey.
    """

    def __init__(self, base: DriveBase, earlier: Journey | None = None) -> None:
        earlier = Journey(0.0, 0.0, 0.0) if earlier is None else earlier
        self.path, self.turn = earlier.path, earlier.turn
        self.track = earlier.track
        self._base = base
        self._stamp = earlier.duration

    def read(self) -> None:
        """Add the motion since the last call to path, turns and track."""
        samples = self._base.odometry_since(self._stamp)
        if not samples:
            return
        path, turn = measure_travel(samples)
        self.path, self.turn = self.path + path, self.turn + turn
        self._stamp = samples[-1].stamp
        poses = [(s.stamp, s.T_odom_base.x, s.T_odom_base.y, s.T_odom_base.yaw) for s in samples]
        self.track = thin_track(np.vstack([self.track, poses]))


class _ProgressLog(Unobserved):
    """Keeps the latest session, and the journey by the end of each view."""

    def __init__(self, robot: Robot, earlier: EarlierRun | None, begun: float) -> None:
        self.session = None if earlier is None else earlier.session
        self.journeys: list[Journey] = []
        before = Journey(0.0, 0.0, begun) if earlier is None else earlier.journey
        self._odometer = JourneyMeter(robot.base, before)
        self._begun = 0.0 if earlier is not None else begun
        self._clock = robot.clock

    def journey(self) -> Journey:
        """Return the journey up to now."""
        self._odometer.read()
        duration = self._clock.now() - self._begun
        meter = self._odometer
        return Journey(meter.path, meter.turn, duration, meter.track)

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session
        self.journeys.append(self.journey())

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session


def _find_target(text: str, truth: Truth | None) -> tuple[float, float] | None:
    """Return the target's place in ``odom`` [m], given as x,y or by name; None if empty."""
    if not text:
        return None
    if "," not in text and truth is not None:
        return truth.locate_shown(text)
    return parse_place(text, "x,y in metres" if truth is None else NAME_OR_PLACE)


def _describe_error(error: BaseException) -> str:
    """Return ``error`` as the stop reason of a run."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return f"{type(error).__name__}: {error}"
