"""The options of the live view.

No postponed annotations here: those of inherited fields are looked up where the child is defined.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.api.watch import WatchOptions
from scan3d_twin.cli.options import env
from scan3d_twin.core.errors import ConfigError

if TYPE_CHECKING:
    from scan3d_twin.core.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Whether and where a run can be watched."""

    view: Annotated[bool, env("VIEW")] = False
    """Show, pause and stop the run on a web page."""
    host: Annotated[str, env("HOST")] = "127.0.0.1"
    """Page address; 0.0.0.0 lets those with the token watch and stop."""
    view_port: Annotated[int, env("VIEW_PORT")] = 8080
    """Port of the page; 0 takes a free one."""
    commands: Annotated[bool, Parameter(show=False)] = False
    """Obey pause, continue, stop and leave, a line each, on standard input."""

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port of the live view; None where none is wanted."""
        return (self.host, self.view_port) if self.view else None

    def watch(
        self,
        speed: str | None = None,
        picture: Callable[[], bytes] = bytes,
        surface: "Callable[[], FloatArray] | None" = None,
    ) -> WatchOptions:
        """Return how the run is watched and commanded; see ``WatchOptions``.

        Raises:
            ConfigError: Commands are to be obeyed without a live view.
        """
        if not self.commands:
            return WatchOptions(self.address, speed, picture, surface=surface)
        if not self.view:
            raise ConfigError("--commands goes with --view")
        from scan3d_twin.cli.remote import RemoteCommands

        return WatchOptions(self.address, speed, picture, RemoteCommands().attach, surface)
