"""One closed loop with an open robot: what ``twin sim``, ``twin real`` and ``twin bench`` share."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.hal import DriveBase, Robot
from scan3d_twin.core.model import evaluation
from scan3d_twin.core.navigation.motion_control import measure_travel
from scan3d_twin.core.observer import Observer, Observers, Unobserved
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.run.report import Journey
from scan3d_twin.run.settings import NAME_OR_PLACE, Settings, stated_place

Timer = Callable[[], float]
"""Returns the computer's time [s] since some moment."""


class Truth(evaluation.Truth, Protocol):
    """What the twin knows besides."""

    def locate(self, name: str) -> tuple[float, float]:
        """Return the place (x, y) in ``odom`` [m] of the target ``name``."""
        ...


Opening = AbstractContextManager[tuple[Robot, Truth | None]]
"""Opens a robot, and the truth if anybody knows it."""


@dataclass(frozen=True)
class Loop:
    """What came of a closed loop.

    Attributes:
        session: As far as it got.
        journey: What the robot did in all.
        journeys: What it had done by the end of each view.
        plan_times: What the planner took for each view, by the timer [s].
        ended: What ended it before its time; None when the planner did.
    """

    session: Session
    journey: Journey
    journeys: tuple[Journey, ...]
    plan_times: tuple[float, ...]
    ended: BaseException | None


@dataclass(frozen=True)
class Earlier:
    """The part of a run that is done when another one goes on from there.

    Attributes:
        session: Its views and plans.
        journey: What the robot has done.
    """

    session: Session
    journey: Journey


def close_loop(
    robot: Robot,
    truth: Truth | None,
    settings: Settings,
    observer: Observer,
    timer: Timer,
    earlier: Earlier | None = None,
    begun: float = 0.0,
) -> Loop:
    """Digitise with an open robot, whatever ends it.

    Args:
        robot: Open and at rest.
        truth: Finds a target by name; None if nobody knows it.
        settings: The effective ones.
        observer: Sees every step.
        timer: Times the planner.
        earlier: What to go on from.
        begun: The robot's time from which its way counts, unless there is an earlier one [s].

    Raises:
        BaseException: Whatever ended the loop before there was a view.
    """
    planner = TimedPlanner(make_planner(settings.config.planner, truth), timer)
    log = _Log(robot, earlier, begun)
    target = _target(settings.run.target, truth)
    ended: BaseException | None = None
    try:
        session = run_loop(
            robot,
            planner,
            settings.config,
            settings.run.seed,
            Observers(log, observer),
            target,
            None if earlier is None else earlier.session,
        )
    except BaseException as error:
        if log.session is None:
            raise
        ended, session = error, log.session.with_stop_reason(_words(error))
    return Loop(session, log.journey(), tuple(log.journeys), tuple(planner.seconds), ended)


class TimedPlanner:
    """A planner that knows how long it thought about each view [s]."""

    def __init__(self, planner: Planner, timer: Timer) -> None:
        self.seconds: list[float] = []
        self._planner = planner
        self._timer = timer

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """See ``Planner.plan``; asked twice about a view, the times add up."""
        started = self._timer()
        self.seconds += [0.0] * (len(session.views) - len(self.seconds))
        try:
            return self._planner.plan(session, rng)
        finally:
            self.seconds[-1] += self._timer() - started


class Odometer:
    """The way of a base; to be read before the base forgets its odometry.

    Counts from when the base was opened, or goes on from an ``earlier`` journey.
    """

    def __init__(self, base: DriveBase, earlier: Journey | None = None) -> None:
        earlier = Journey(0.0, 0.0, 0.0) if earlier is None else earlier
        self.path, self.turn = earlier.path, earlier.turn
        self._base = base
        self._stamp = earlier.duration

    def read(self) -> None:
        """Add the way since the last reading to ``path`` [m] and ``turn`` [rad]."""
        samples = self._base.odometry_since(self._stamp)
        if not samples:
            return
        path, turn = measure_travel(samples)
        self.path, self.turn = self.path + path, self.turn + turn
        self._stamp = samples[-1].stamp


class _Log(Unobserved):
    """Keeps the last session at hand and notes the way by the end of each view."""

    def __init__(self, robot: Robot, earlier: Earlier | None, begun: float) -> None:
        self.session = None if earlier is None else earlier.session
        self.journeys: list[Journey] = []
        before = Journey(0.0, 0.0, begun) if earlier is None else earlier.journey
        self._odometer = Odometer(robot.base, before)
        self._begun = 0.0 if earlier is not None else begun
        self._clock = robot.clock

    def journey(self) -> Journey:
        """Return what the robot did so far."""
        self._odometer.read()
        duration = self._clock.now() - self._begun
        return Journey(self._odometer.path, self._odometer.turn, duration)

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session
        self.journeys.append(self.journey())

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self.session = session


def _target(text: str, truth: Truth | None) -> tuple[float, float] | None:
    """Return the place in ``odom`` [m] that ``text`` states as x,y or by name; None if empty."""
    if not text:
        return None
    if "," not in text and truth is not None:
        return truth.locate(text)
    return stated_place(text, "x,y in metres" if truth is None else NAME_OR_PLACE)


def _words(error: BaseException) -> str:
    """Return ``error`` as the reason why a run ended."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return f"{type(error).__name__}: {error}"
