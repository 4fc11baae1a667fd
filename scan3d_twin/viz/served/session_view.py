"""A recorded run on a page: what it had read and planned at any time of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from scan3d_twin.core.model.fused_cloud import measure_scanned_share
from scan3d_twin.core.scanning.target.extraction import extract_points
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Scan3D
from scan3d_twin.recording.load import RecordedRun, read_track
from scan3d_twin.run.settings import REAL_SCENE
from scan3d_twin.viz.served.banner import Banner, State
from scan3d_twin.viz.served.live import format_plan
from scan3d_twin.viz.served.look_controls import add_look_controls
from scan3d_twin.viz.served.markdown import as_text
from scan3d_twin.viz.served.player import Player
from scan3d_twin.viz.served.stage import Stage
from scan3d_twin.viz.timeline import Timeline
from scan3d_twin.viz.view_errors import (
    ViewError,
    format_view_errors,
    list_view_errors,
    read_view_errors,
)

TIME_STEP = 0.1
"""Step of the time slider [s]: the line period of the URG-04LX."""
NO_TRACK = np.zeros((0, 4))


class SessionView:
    """The page of a recorded session."""

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        session: Session,
        *,
        track: FloatArray = NO_TRACK,
        errors: tuple[ViewError, ...] | None = None,
        truth: Callable[[], FloatArray] | None = None,
        state: State = "finished",
    ) -> None:
        """Build the page of ``session``, called ``name``, at its end.

        Args:
            server: Serves the page.
            name: What the panel is called.
            session: The session.
            track: The odometry, see ``read_track``; without it the robot jumps between viewpoints.
            errors: Errors of the views; None for the predicted ones only.
            truth: See ``add_look_controls``.
            state: How the run ended.
        """
        self._session = session
        self._errors = list_view_errors(session, {}) if errors is None else errors
        self._timeline = Timeline.of(session, track)
        self._lock = threading.RLock()
        self._known, self._following = -1, False
        self._panoramas: dict[int, Scan3D] = {}
        self._stage = Stage(server)
        self._stage.show_views(session)
        self._stage.aim_camera(session)
        self._build(server.gui, name, state, truth)
        self._show(self._timeline.end, len(session.views))

    @staticmethod
    def of_run(server: viser.ViserServer, run: RecordedRun) -> SessionView:
        """Return the page of a recorded ``run``, with all that its folder tells."""
        simulated = run.settings.run.scene != REAL_SCENE
        return SessionView(
            server,
            run.name,
            run.session,
            track=read_track(run.path),
            errors=read_view_errors(run),
            truth=(lambda: _true_triangles(run)) if simulated else None,
            state=_state(run),
        )

    def _build(
        self, gui: Any, name: str, state: State, truth: Callable[[], FloatArray] | None
    ) -> None:
        # Progress
        gui.set_panel_label(name)
        Banner(gui, state)
        self._words = gui.add_markdown("")
        self._bar = gui.add_progress_bar(0.0)

        # Sliders
        count, end = len(self._session.views), self._timeline.end
        last = math.ceil(end / TIME_STEP) * TIME_STEP
        self._views = gui.add_slider("Views", min=0, max=max(1, count), step=1, initial_value=count)
        self._time = gui.add_slider("Time [s]", 0.0, last, TIME_STEP, initial_value=last)
        self._views.on_update(lambda _: self._on_views())
        self._time.on_update(lambda _: self._on_time())
        Player(gui, self._time)

        # Appearance and plan
        add_look_controls(gui, self._stage, lambda: self._session, truth)
        self._plan = gui.add_markdown("")
        self._table = gui.add_markdown("")

    def _on_views(self) -> None:
        """Show the run at the end of the view that was chosen; the time follows."""
        with self._lock:
            count = min(int(self._views.value), len(self._session.views))
            if count == self._known:
                return
            ends, whole = self._timeline.ends, count == len(self._session.views)
            time = self._timeline.end if whole else float(ends[count - 1]) if count else 0.0
            self._show(time, count, sweeping=False)
            self._following = True
            self._time.value = math.ceil(time / TIME_STEP) * TIME_STEP
            self._following = False

    def _on_time(self) -> None:
        """Show the run at the time that was chosen; the views follow."""
        with self._lock:
            if self._following:
                return
            time = min(float(self._time.value), self._timeline.end)
            count = self._timeline.count_finished(time)
            self._show(time, count)
            self._views.value = count

    def _show(self, time: float, count: int, *, sweeping: bool = True) -> None:
        """Show the run at ``time`` [s], after ``count`` views, and what it is ``sweeping``."""
        # Show the robot and what it was reading
        stage, timeline = self._stage, self._timeline
        stage.show_robot(timeline.pose_at(time))
        stage.show_path(timeline.path_until(time))
        sweeping = sweeping and count < self._total
        lines = timeline.lines_read(count, self._session, time) if sweeping else 0
        if lines:
            stage.show_sweep(self._session, count, lines)
        elif not (sweeping and self._show_panorama(time, count)):
            stage.hide_sweep()

        # Show the views and what was planned after them
        if count != self._known:
            self._known = count
            self._show_views(count)

    def _show_panorama(self, time: float, count: int) -> bool:
        """Show what was read at ``time`` [s] of the panorama after ``count`` views, if any was."""
        for k, (taken, panorama) in enumerate(self._session.panoramas):
            stamps = panorama.image.stamps
            if taken == count and stamps.min() <= time <= stamps.max():
                view = self._session.views[max(0, taken - 1)]
                if k not in self._panoramas:
                    self._panoramas[k] = extract_points(panorama.image, self._session.config)
                lines = int(np.count_nonzero(stamps <= time))
                placed = view.T_world_odom @ panorama.T_odom_scan
                self._stage.show_panorama(placed, self._panoramas[k], lines)
                return True
        return False

    @property
    def _total(self) -> int:
        return len(self._session.views)

    def _show_views(self, count: int) -> None:
        """Show the first ``count`` views, the plan made after them and the progress in words."""
        # Cut the session to that time
        whole = self._session
        past = replace(whole, views=whole.views[:count], plans=whole.plans[:count])
        self._stage.show_upto(count)
        self._stage.show_plan(past)

        # Show the progress in words
        share = measure_scanned_share(past)
        self._bar.value = 100.0 * share
        done = count == self._total and whole.stop_reason
        ended = f": {as_text(whole.stop_reason)}" if done else ""
        which = f"view {count - 1}" if count else "no view"
        self._words.content = (
            f"**{which} ({count} of {self._total} views)**, outline in top view "
            f"{share:.0%} scanned{ended}"
        )

        # Show plan and errors
        self._plan.content = format_plan(past) if past.plans else ""
        known = tuple(each for each in self._errors if each.view < count)
        self._table.content = format_view_errors(known, whole.config.planning.epsilon)


def _state(run: RecordedRun) -> State:
    """Return how ``run`` ended, for the banner."""
    if run.running:
        return "running"
    return "finished" if run.finished else "interrupted"


def _true_triangles(run: RecordedRun) -> FloatArray:
    from scan3d_twin.viz.true_scene import true_triangles  # a second, and only where it is wanted

    return true_triangles(run)
