"""The banner of a page: whether the run goes on, waits, or is over, and why."""

from __future__ import annotations

import html
from typing import Any, Literal

State = Literal[
    "waiting", "running", "pausing", "paused", "stopped", "finished", "failed", "interrupted"
]  # fmt: skip
"""State of a run: pausing until the current view is finished; stopped by the user; failed with an
error; interrupted without an end, as by a power cut."""

COLOURS: dict[State, str] = {
    "waiting": "#57606a",
    "running": "#0b62c4",
    "pausing": "#8a5a00",
    "paused": "#8a5a00",
    "stopped": "#b42318",
    "finished": "#1a7f37",
    "failed": "#b42318",
    "interrupted": "#b42318",
}
"""Background by state; white text has a contrast of 4.5 or more on each (WCAG AA)."""


class Banner:
    """The banner at the top of the panel."""

    def __init__(self, gui: Any, state: State) -> None:
        self.state: State = state
        self._html = gui.add_html("")
        self.show(state)

    def show(self, state: State) -> None:
        """Show ``state``."""
        self.state = state
        style = (
            f"background:{COLOURS[state]};color:#fff;font-weight:600;text-align:center;"
            "border-radius:4px;padding:4px 8px;margin:6px 12px 2px"
        )
        content = f'<div role="status" style="{style}">{html.escape(state)}</div>'
        if self._html.content != content:
            self._html.content = content
