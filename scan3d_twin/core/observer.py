"""How progress, recording, live views and stop buttons attach to a run, and how they share it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, Protocol

from scan3d_twin.core.hal import Clock, Robot
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine

Command = Literal["go", "pause", "stop"]
_STRONGEST_FIRST: tuple[Command, ...] = ("stop", "pause", "go")


class Observer(Protocol):
    """How progress, recording, views and stop buttons attach to a run.

    Whatever a method raises ends the run as an error of the robot would: the wheels are stopped.

    >>> class StopAfterOne(s3d.Unobserved):
    ...     finished = False
    ...
    ...     def on_view(self, session):
    ...         self.finished = True
    ...
    ...     def command(self):
    ...         return "stop" if self.finished else "go"
    >>> with s3d.open_sim("three_boxes") as (robot, truth):
    ...     stopped = s3d.digitize(robot, observer=StopAfterOne())
    >>> len(stopped.views), stopped.stop_reason
    (1, 'stopped by the user')
    """

    def on_event(self, text: str) -> None:
        """Something worth a line happened."""
        ...

    def on_line(self, line: ScanLine) -> None:
        """A scan line arrived."""
        ...

    def on_view(self, session: Session) -> None:
        """The last view of ``session`` was added."""
        ...

    def on_plan(self, session: Session) -> None:
        """The last plan of ``session`` was made."""
        ...

    def command(self) -> Command:
        """Return what the user wants now."""
        ...


class Unobserved:
    """A null object behind the ``Observer`` protocol.

    >>> s3d.Unobserved().command()
    'go'
    """

    def on_event(self, text: str) -> None:
        """See ``Observer``."""

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""

    def command(self) -> Command:
        """See ``Observer``: go on to the end."""
        return "go"


class Observers:
    """Several observers as one; each is told everything, in the order in which they were given."""

    def __init__(self, *observers: Observer) -> None:
        self._observers = observers

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        for each in self._observers:
            each.on_event(text)

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""
        for each in self._observers:
            each.on_line(line)

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        for each in self._observers:
            each.on_view(session)

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        for each in self._observers:
            each.on_plan(session)

    def command(self) -> Command:
        """See ``Observer``: one stop stops all, one pause pauses all."""
        wanted = {each.command() for each in self._observers}
        return next((command for command in _STRONGEST_FIRST if command in wanted), "go")


class _AttendedClock:
    """A clock that calls whoever attends the run each time the robot has waited."""

    def __init__(self, clock: Clock, attendants: tuple[Callable[[], None], ...]) -> None:
        self._clock = clock
        self._attendants = attendants
        self.now = clock.now

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        self._clock.sleep(seconds)
        for attend in self._attendants:
            attend()


def attended(robot: Robot, *attendants: Callable[[], None]) -> Robot:
    """Return ``robot`` with all ``attendants`` called while it drives and turns, where no line is.

    The motions wait on the robot's clock every 30 ms, so that the attendants see the odometry of
    the whole way. What one of them raises ends the motion with the wheels stopped; between the
    lines of a sweep ``Observer.on_line`` does the same.
    """
    return replace(robot, clock=_AttendedClock(robot.clock, attendants))
