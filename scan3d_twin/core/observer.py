"""The observer that watches nothing, for programs that only want the result of a run."""

from __future__ import annotations

from typing import Literal

from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine


class Unobserved:
    """A null object behind the ``Observer`` protocol."""

    def on_event(self, text: str) -> None:
        """See ``Observer``."""

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""

    def command(self) -> Literal["go"]:
        """See ``Observer``: go on to the end."""
        return "go"
