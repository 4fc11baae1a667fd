"""Progress of a run on standard error: a live line on a terminal, plain lines elsewhere.

Views are numbered from 0, as in the files of a run; "1 view of at most 20" counts them. The share
of the outline is what the robot itself can know: in the top view, and of what it found when it
first looked around. How much of the surface is covered needs the truth, see ``summary``.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from scan3d_twin.cli.output import say
from scan3d_twin.cli.summary import count
from scan3d_twin.core.model.fused_cloud import measure_scanned_share
from scan3d_twin.core.observer import Observer, Unobserved
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

_OUTLINES = {"front": "front outline", "full": "outline all round"}


@contextmanager
def make_progress() -> Iterator[Observer]:
    """Open the progress that fits standard error."""
    if not sys.stderr.isatty():
        yield PlainProgress()
        return
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    if not console.is_terminal or console.is_dumb_terminal:
        yield PlainProgress()
        return
    with make_bar(console) as bar:
        yield LiveProgress(bar, bar.add_task("opening the robot", total=None, left=""))


def make_bar(console: Console) -> Progress:
    """Return the live line: what is done now, how far the run is, and how long it will take."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (
        SpinnerColumn(), BarColumn(bar_width=20), TextColumn("{task.fields[left]}", markup=False),
        TextColumn("{task.description}", markup=False),
    )  # fmt: skip
    return Progress(*columns, console=console, transient=True)


class Pace:
    """How long a run has taken and will take at most, after each view."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began = clock()
        self._views = 0
        self.left = ""

    def view(self, session: Session) -> str:
        """Return the views taken, the robot's time, the computer's and how much is left at most.

        The time left is that of a run of ``max_views`` at the pace of the views taken; most runs
        are complete before.
        """
        elapsed, done = self._clock() - self._began, len(session.views)
        self._views += 1
        left = elapsed / self._views * (session.config.max_views - done)
        stamp = float(session.views[-1].observation.image.stamps.max())
        self.left = _time_left(left, "at most ")
        return (
            f"; {count(done, 'view')} of at most {session.config.max_views}, "
            f"{stamp:.0f} s on the robot's clock, {elapsed:.0f} s elapsed{self.left}"
        )


def steps(
    progress: Observer, what: str, total: int, clock: Callable[[], float] = time.monotonic
) -> Callable[[int], None]:
    """Return a function that reports each of ``total`` steps done, by its index from 0.

    With ``what`` was done, how many steps are, and how long the others will take.
    """
    started = clock()

    def step(index: int) -> None:
        done = index + 1
        left = (clock() - started) / done * (total - done)
        progress.on_event(f"{what} {index}: {done} of {total} done" + _time_left(left))

    return step


def _time_left(seconds: float, bound: str = "") -> str:
    """Return how much time is left, after a comma; nothing if it rounds to 0 s."""
    return f", {bound}{seconds:.0f} s left" if round(seconds) > 0 else ""


class PlainProgress(Unobserved):
    """One line per step."""

    def __init__(self) -> None:
        self._pace = Pace()

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        say(text)

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        self.on_event(view_words(session) + self._pace.view(session))

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self.on_event(plan_words(session))


class LiveProgress(Unobserved):
    """One line per view and plan, and below them a bar: the views taken of those allowed."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task = bar, task
        self._doing, self._lines = "", 0
        self._pace = Pace()

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self._doing, self._lines = text, 0
        self._bar.update(self._task, description=text)

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""
        self._lines += 1
        self._bar.update(self._task, description=f"{self._doing}: {self._lines} lines")

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        words = view_words(session) + self._pace.view(session)
        self._bar.console.print(words, markup=False)
        done, allowed = len(session.views), session.config.max_views
        left = f"{done}/{allowed}{self._pace.left}"
        self._bar.update(self._task, total=allowed, completed=done, left=left)
        self.on_event("planning")

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self._bar.console.print(plan_words(session), markup=False)


def view_words(session: Session) -> str:
    """Return the last view in a line."""
    index, view = len(session.views) - 1, session.views[-1]
    share = measure_scanned_share(session)
    words = (
        f"view {index}: {view.observation.image.n_lines} lines, {len(view.target)} points; "
        f"{_OUTLINES[session.config.tour]} in top view: {share:.0%} scanned"
    )
    lost = view.registration is not None and not view.registration.converged
    return words + ("; NOT registered: placed by odometry" if lost else "")


def plan_words(session: Session) -> str:
    """Return the last plan in a line."""
    plan = session.plans[-1]
    if plan.viewpoint is None:
        return f"finished: {plan.reason}"
    known = math.isfinite(plan.predicted_rmse)
    error = f"{1e3 * plan.predicted_rmse:.1f} mm" if known else "unknown"
    return f"  next: {plan.overlap:.0%} overlap, predicted error {error} ({plan.reason})"
