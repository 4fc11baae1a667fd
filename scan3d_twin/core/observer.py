"""Observers: how progress, recording, live views and stop buttons attach to a run."""

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
    """Callbacks for what happens in a run, and the user's command to it.

    An exception from a method ends the run as an error of the robot does: the wheels are stopped.

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
        """Handle an event that is worth one line of text."""
        ...

    def on_line(self, line: ScanLine) -> None:
        """Handle a scan line as it arrives."""
        ...

    def on_view(self, session: Session) -> None:
        """Handle the last view of ``session``, which was just added."""
        ...

    def on_plan(self, session: Session) -> None:
        """Handle the last plan of ``session``, which was just made."""
        ...

    def command(self) -> Command:
        """Return what the user wants now."""
        ...


class Unobserved:
    """An observer that does nothing (a null object).

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
    """Several observers as one: each call goes to all of them, in the order they were given."""

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
        """See ``Observer``; the strongest command wins: stop, then pause, then go."""
        wanted = {each.command() for each in self._observers}
        return next((command for command in _STRONGEST_FIRST if command in wanted), "go")


class _ObservedClock:
    """A clock that calls back each time the robot has waited."""

    def __init__(self, clock: Clock, callbacks: tuple[Callable[[], None], ...]) -> None:
        self._clock = clock
        self._callbacks = callbacks
        self.now = clock.now

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        self._clock.sleep(seconds)
        for callback in self._callbacks:
            callback()


def with_clock_callbacks(robot: Robot, *callbacks: Callable[[], None]) -> Robot:
    """Return ``robot`` with a clock that calls all ``callbacks`` whenever it has waited.

    Drives and turns wait on the clock every 30 ms, so that the callbacks see the odometry of the
    whole way; during a sweep ``Observer.on_line`` is called instead. An exception from a callback
    ends the motion with the wheels stopped.
    """
    return replace(robot, clock=_ObservedClock(robot.clock, callbacks))
