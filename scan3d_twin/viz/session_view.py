"""A recorded run on a page: its views and plans, with a slider over them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import viser

from scan3d_twin.core.model.fused_cloud import measure_scanned_share
from scan3d_twin.core.session import Session
from scan3d_twin.viz.live import format_plan
from scan3d_twin.viz.markdown import as_text
from scan3d_twin.viz.stage import Stage, add_look_controls


class SessionView:
    """The page of a recorded session."""

    def __init__(self, server: viser.ViserServer, name: str, session: Session) -> None:
        self._session = session
        self._stage = Stage(server)
        self._stage.show_views(session)
        self._stage.aim_camera(session)
        self._build(server.gui, name, len(session.views))
        self._show(len(session.views))

    def _build(self, gui: Any, name: str, count: int) -> None:
        gui.set_panel_label(name)
        self._words = gui.add_markdown("")
        self._bar = gui.add_progress_bar(0.0)
        step = gui.add_slider("Views", min=1, max=max(2, count), step=1, initial_value=count)
        step.disabled = count < 2
        step.on_update(lambda _: self._show(int(step.value)))
        add_look_controls(gui, self._stage)
        self._plan = gui.add_markdown("")

    def _show(self, count: int) -> None:
        """Show the run after ``count`` views, with the plan made then."""
        # Cut the session to that time
        whole = self._session
        count = min(count, len(whole.views))
        past = replace(whole, views=whole.views[:count], plans=whole.plans[:count])
        view = past.views[-1]

        # Show views, robot and plan
        self._stage.show_upto(count)
        self._stage.show_robot(view.T_world_scan)
        self._stage.show_plan(past)

        # Show the progress in words
        share = measure_scanned_share(past)
        self._bar.value = 100.0 * share
        last = len(whole.views) - 1
        ended = f": {as_text(whole.stop_reason)}" if count > last and whole.stop_reason else ""
        self._words.content = (
            f"**view {count - 1} ({count} of {len(whole.views)} views)**, outline in top view "
            f"{share:.0%} scanned{ended}"
        )
        self._plan.content = format_plan(past) if past.plans else ""
