"""The optional live view of a run on a web page, and the picture of its scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Robot
    from scan3d_twin.core.model.truth import Truth
    from scan3d_twin.core.observer import Observer
    from scan3d_twin.core.types import FloatArray
    from scan3d_twin.viz.served.banner import State
    from scan3d_twin.viz.served.live import LiveView


STAYS = "the live view stays until its page is closed, or Ctrl-C"
"""Ends the line that tells the user how the run ended, when it is saved and its page still read."""


def _leave(view: LiveView) -> None:
    """Do nothing with the live view."""


@dataclass(frozen=True, slots=True)
class RunWatcher:
    """The live view of one run, if there is one.

    Attributes:
        view: The live view; None without one.
        picture: Returns a picture of the scene as PNG; no bytes of a real one.
    """

    view: LiveView | None
    picture: Callable[[], bytes]

    def attach(
        self, robot: Robot, observer: Observer, truth: Truth | None
    ) -> tuple[Robot, Observer]:
        """Return ``robot`` and ``observer`` with the view, which knows ``truth``, among them."""
        from scan3d_twin.core.observer import Observers

        if self.view is None:
            return robot, observer
        return self.view.attach(robot, truth), Observers(observer, self.view)

    def finish(
        self, reason: str, report: Callable[[str], None], ended: BaseException | None = None
    ) -> None:
        """Show on the page why the run ended, and serve it until nobody reads it.

        Args:
            reason: Why it ended.
            report: Tells the user that the page stays.
            ended: The error that ended the run; None if the planner did.
        """
        if self.view is None:
            return
        state: State = "finished"
        if ended is not None:
            state = "stopped" if isinstance(ended, KeyboardInterrupt) else "failed"
        self.view.finish(reason, state)
        if self.view.has_readers():
            report(f"{state}: {STAYS}")
            self.view.wait_for_readers()


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """Options of the live view of a run.

    Attributes:
        address: Host and TCP port at which the live view is served; None for no live view.
        speed: Speed limit of the twin while it is watched, such as ``10x``; None for a real robot.
        picture: See ``RunWatcher``.
        on_open: Given the live view when it is served.
        surface: See ``LiveView``.
    """

    address: tuple[str, int] | None = None
    speed: str | None = None
    picture: Callable[[], bytes] = bytes
    on_open: Callable[[LiveView], None] = _leave
    surface: Callable[[], FloatArray] | None = None

    @contextmanager
    def open_watcher(self, name: str, report: Callable[[str], None]) -> Iterator[RunWatcher]:
        """Serve the live view of the run called ``name`` if there is an address.

        Raises:
            LinkError: The view cannot be served there.
        """
        if self.address is None:
            yield RunWatcher(None, self.picture)
            return
        from scan3d_twin.viz.served.live import open_live_view

        host, port = self.address
        with open_live_view(host, port, name, self.speed, report, self.surface) as view:
            self.on_open(view)
            yield RunWatcher(view, self.picture)


UNWATCHED = WatchOptions()
"""No live view and no picture of the scene."""
