"""The options of the live view.

No postponed annotations here: those of inherited fields are looked up where the child is defined.
"""

from dataclasses import dataclass
from typing import Annotated

from scan3d_twin.cli.options import env


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Whether and where a run can be watched."""

    view: Annotated[bool, env("VIEW")] = False
    """Show, pause and stop the run on a web page."""
    host: Annotated[str, env("HOST")] = "127.0.0.1"
    """Page address; 0.0.0.0 lets those with the token watch and stop."""
    view_port: Annotated[int, env("VIEW_PORT")] = 8080
    """Port of the page; 0 takes a free one."""

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port of the live view; None where none is wanted."""
        return (self.host, self.view_port) if self.view else None
