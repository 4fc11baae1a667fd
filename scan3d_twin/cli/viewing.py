"""The options of the live view, and what a run shows of itself.

No postponed annotations here: those of inherited fields are looked up where the child is defined.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from scan3d_twin.cli.options import env

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Robot
    from scan3d_twin.core.observer import Observer
    from scan3d_twin.viz.live import LiveView


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Whether and where a run can be watched."""

    view: Annotated[bool, env("VIEW")] = False
    """Serve a web page that shows the run and can pause and stop it."""
    host: Annotated[str, env("HOST")] = "127.0.0.1"
    """Address at which the page is served; 0.0.0.0 lets others watch, and stop the robot."""
    view_port: Annotated[int, env("VIEW_PORT")] = 8080
    """TCP port of the page; 0 takes a free one."""


@dataclass(frozen=True, slots=True)
class Onlooker:
    """Who watches a run, if anybody does.

    Attributes:
        view: The live view; None where none is wanted.
        picture: Returns a picture of the scene as PNG, or why there is none.
    """

    view: "LiveView | None"
    picture: Callable[[], bytes | str]

    def attach(self, robot: "Robot", observer: "Observer") -> tuple["Robot", "Observer"]:
        """Return ``robot`` and ``observer`` with the view among those that watch."""
        from scan3d_twin.core.observer import Observers

        if self.view is None:
            return robot, observer
        return self.view.attach(robot), Observers(observer, self.view)

    def end(self, reason: str, tell: Callable[[str], None]) -> None:
        """Tell the page why the run ended, and stay while somebody reads it."""
        if self.view is None:
            return
        self.view.finish(reason)
        if self.view.is_read():
            tell("the live view stays until its page is closed, or Ctrl-C")
            self.view.wait_for_readers()


@dataclass(frozen=True, slots=True)
class Watch:
    """How a run wants to be watched.

    Attributes:
        options: The user's.
        speed: Of the twin while it is watched; None for a real robot.
        picture: See ``Onlooker``.
    """

    options: ViewOptions = ViewOptions()
    speed: str | None = None
    picture: Callable[[], bytes | str] = str

    @contextmanager
    def onlooker(self, name: str, tell: Callable[[str], None]) -> Iterator[Onlooker]:
        """Serve the live view of the run called ``name`` if one is wanted.

        Raises:
            LinkError: It cannot be served there.
        """
        if not self.options.view:
            yield Onlooker(None, self.picture)
            return
        from scan3d_twin.viz.live import open_live_view

        host, port = self.options.host, self.options.view_port
        with open_live_view(host, port, name, self.speed, tell) as view:
            yield Onlooker(view, self.picture)


UNWATCHED = Watch()
