"""The live view of a run: a web page that shows it and can pause and stop it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from scan3d_twin.core.hal import Lidar, Robot
from scan3d_twin.core.model.fused_cloud import measure_scanned_share
from scan3d_twin.core.model.pose_errors import lay_on_truth
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.observer import Command, with_clock_callbacks
from scan3d_twin.core.scanning.turning import find_lidar_pose
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, LidarSpec, Pose2, ScanLine
from scan3d_twin.viz.served.banner import Banner, State
from scan3d_twin.viz.served.look_controls import add_look_controls
from scan3d_twin.viz.served.markdown import as_text
from scan3d_twin.viz.served.server import describe_reach, open_server
from scan3d_twin.viz.served.stage import Stage
from scan3d_twin.viz.track import place_track
from scan3d_twin.viz.view_errors import (
    format_view_errors,
    list_view_errors,
    measure_view_errors,
)

REFRESH_PERIOD = 0.1
"""Time between two updates of the moving robot [s]: the lidar's line period."""
PATH_STEP = 0.1
"""Distance between two places of the way driven [m]."""
PAUSE_PERIOD = 0.05
"""Time between two checks of the buttons while paused [s]."""
SPEEDS = {"real time": 1.0, "2x": 2.0, "5x": 5.0, "10x": 10.0, "30x": 30.0, "unlimited": 0.0}
"""Speeds of the twin by name; 0 for no limit."""
RELOAD_TIME = 3.0
"""Longest time that a page takes to reload [s]."""
ADDRESS = "live view: "
"""Begins the line that tells the user the page's address."""
ANNOUNCED: dict[State, str] = {
    "pausing": "pausing when the current view is finished",
    "paused": "paused: waits for Continue",
    "running": "continuing",
    "stopped": "stopped in the live view",
}
"""Lines that tell the user what a button did, by the state of the run."""


def _ignore(text: str) -> None:
    """Tell nobody."""


class LiveView:
    """An ``Observer`` that shows a run on a page and obeys the page's buttons.

    The run calls all its methods; the buttons only set flags.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        speed: str | None,
        notify: Callable[[str], None] = _ignore,
        surface: Callable[[], FloatArray] | None = None,
    ) -> None:
        """Build the page.

        Args:
            server: Serves the page.
            name: What the panel is called.
            speed: One of ``SPEEDS`` for a twin, None for a real robot.
            notify: Told in a line when the run is paused and continued.
            surface: Returns the triangles (m, 3, 3) of the true target in ``map`` [m]; None where
                nobody knows it.
        """
        self.stage = Stage(server)
        self._server, self._notify = server, notify
        self._stop, self._pause, self._leave = (threading.Event() for _ in range(3))
        self._robot: Robot | None = None
        self._truth: Truth | None = None
        self._surface, self._T_world_map = surface, Pose2()
        self._session: Session | None = None
        self._track: list[tuple[float, float, float, float]] = []
        self._T_world_odom = Pose2()
        self._drawn, self._followed, self._path_drawn = 0.0, -math.inf, 0
        self._pace = _Pace(SPEEDS[speed]) if speed else None
        self._build(server.gui, name, speed)

    def _build(self, gui: Any, name: str, speed: str | None) -> None:
        gui.set_panel_label(name)
        self._banner = Banner(gui, "waiting")
        self._status = gui.add_markdown("waiting for the robot")
        self._share = gui.add_markdown("scanned: 0 %")
        self._bar = gui.add_progress_bar(0.0)
        self._build_buttons(gui)
        self._timeline = gui.add_slider("Views", 0, 1, step=1, initial_value=1, disabled=True)
        self._timeline.on_update(lambda _: self.stage.show_upto(int(self._timeline.value)))
        truth = None if self._surface is None else self._place_surface
        add_look_controls(gui, self.stage, lambda: self._session, truth)
        if speed is not None:
            chosen = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=speed)
            chosen.on_update(lambda _: self._set_speed(chosen.value))
        self._plan = gui.add_markdown("")
        self._errors = gui.add_markdown("")

    def _build_buttons(self, gui: Any) -> None:
        self._pause_button = gui.add_button(
            "Pause", icon=viser.Icon.PLAYER_PAUSE, hint="Waits when the current view is finished"
        )
        self._continue_button = gui.add_button(
            "Continue", icon=viser.Icon.PLAYER_PLAY, color="green", visible=False
        )
        self._stop_button = gui.add_button(
            "Stop", icon=viser.Icon.HAND_STOP, color="red", hint="Stops the wheels at once"
        )
        self._pause_button.on_click(lambda _: self.set_pause(True))
        self._continue_button.on_click(lambda _: self.set_pause(False))
        self._stop_button.on_click(lambda _: self._set_stop())

    def set_pause(self, wanted: bool) -> None:
        """Let the run wait when the current view is finished, or go on."""
        (self._pause.set if wanted else self._pause.clear)()
        self._pause_button.visible, self._continue_button.visible = not wanted, wanted
        if not self._stop.is_set():
            self._announce("pausing" if wanted else "running")

    def _announce(self, state: State) -> None:
        """Show ``state`` on the banner, and tell the user of it once."""
        if self._banner.state != state:
            self._banner.show(state)
            self._notify(ANNOUNCED[state])

    def _set_stop(self) -> None:
        self._stop.set()
        self._announce("stopped")
        for button in (self._pause_button, self._continue_button, self._stop_button):
            button.disabled = True

    def _set_speed(self, name: str) -> None:
        self._pace = _Pace(SPEEDS[name])

    def _place_surface(self) -> FloatArray | None:
        """Return the true surface in ``world``; None before the first view, which defines that."""
        if self._truth is None or self._session is None or self._surface is None:
            return None
        triangles = self._surface().reshape(-1, 3)
        return self._T_world_map.apply(triangles).reshape(-1, 3, 3)

    def attach(self, robot: Robot, truth: Truth | None = None) -> Robot:
        """Return ``robot`` wrapped so that the page follows it and can stop it.

        Args:
            robot: The robot.
            truth: What the page measures the views by; None where there is none.
        """
        self._robot, self._truth = robot, truth
        if self._banner.state == "waiting":
            self._banner.show("running")
        return with_clock_callbacks(replace(robot, lidar=_LineByLine(robot.lidar)), self.attend)

    def attend(self) -> None:
        """Show where the robot is; stop it if the stop button was pressed.

        Raises:
            KeyboardInterrupt: The stop button was pressed.
        """
        if self._stop.is_set():
            raise KeyboardInterrupt("stopped in the live view")
        if self._robot is None:
            return
        if self._pace is not None:
            self._pace.wait(self._robot.clock.now())
        self._follow(self._robot, self._robot.clock.now())
        if self._due():
            self.stage.show_robot(self._T_world_odom @ self._robot.base.odometry().T_odom_base)
            if len(self._track) > self._path_drawn:
                self._show_path()

    def _follow(self, robot: Robot, now: float) -> None:
        """Add where ``robot`` is ``now`` [s] to the way driven, if it has moved on."""
        if now - self._followed < REFRESH_PERIOD:
            return
        self._followed = now
        pose = robot.base.odometry().T_odom_base
        if not self._track or math.dist(self._track[-1][1:3], (pose.x, pose.y)) >= PATH_STEP:
            self._track.append((now, pose.x, pose.y, pose.yaw))

    def _show_path(self) -> None:
        """Show the way driven, laid through the views; before the first one by odometry."""
        self._path_drawn = len(self._track)
        track = np.array(self._track).reshape(-1, 4)
        placed = track[:, 1:] if self._session is None else place_track(track, self._session)
        self.stage.show_path(placed[:, :2])

    def _due(self) -> bool:
        now = time.monotonic()
        if now - self._drawn < REFRESH_PERIOD:
            return False
        self._drawn = now
        return True

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self._status.content = f"**{as_text(text)}**"

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``; stops as ``attend`` does."""
        # Limit the refresh rate
        due = time.monotonic() - self._drawn >= REFRESH_PERIOD
        self.attend()
        robot = self._robot
        if robot is None or not due:
            return

        # Convert the line to points
        spec, own = robot.lidar.spec, line.elevations
        elevations = spec.elevations if own is None else own
        rays = np.stack([np.cos(elevations), np.zeros_like(elevations), np.sin(elevations)], axis=1)
        seen = np.isfinite(line.ranges)
        points = line.ranges[seen, None] * rays[seen]
        T = find_lidar_pose(robot)
        in_base = points @ T[:3, :3].T + T[:3, 3]

        # Show them in the world
        self.stage.show_line(
            (self._T_world_odom @ robot.base.odometry().T_odom_base).apply(in_base)
        )

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        # Show the views
        view, count, self._session = session.views[-1], len(session.views), session
        self._T_world_odom = view.T_world_odom
        self.stage.show_views(session)
        self._show_path()
        if count == 1:
            self.stage.aim_camera(session)
            if self._truth is not None:
                self._T_world_map = lay_on_truth(session, self._truth).inverse()
        self._show_errors(session)

        # Show the progress
        share = measure_scanned_share(session)
        self._bar.value = 100.0 * share
        what = "front outline" if session.config.tour == "front" else "outline all round"
        self._share.content = f"{what} in top view: {share:.0%} scanned, {count} views"
        self._timeline.max, self._timeline.disabled = max(1, count), False
        self._timeline.value = count

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self.stage.show_views(session)
        self.stage.show_plan(session)
        self._plan.content = format_plan(session)
        self._show_errors(session)

    def _show_errors(self, session: Session) -> None:
        """Show the predicted error of each view and, where the truth is known, the realised one."""
        realised = {} if self._truth is None else measure_view_errors(session, self._truth)
        errors = list_view_errors(session, realised)
        self._errors.content = format_view_errors(errors, session.config.planning.epsilon)

    def command(self) -> Command:
        """See ``Observer``: stop and pause between two views."""
        if self._stop.is_set():
            return "stop"
        if self._pause.is_set():
            self._status.content = "waits for *Continue*"
            self._announce("paused")
            time.sleep(PAUSE_PERIOD)
            return "pause"
        return "go"

    def finish(self, text: str, state: State = "finished") -> None:
        """Show ``text`` as the end of the run that is in ``state``, and hide the buttons."""
        self._banner.show("stopped" if self._stop.is_set() else state)
        self._status.content = f"**{as_text(text)}**"
        self.stage.hide_line()
        for button in (self._pause_button, self._continue_button, self._stop_button):
            button.visible = False

    def leave(self) -> None:
        """Let the page end with the run, whoever reads it."""
        self._leave.set()

    def has_readers(self) -> bool:
        """Return whether a page is open."""
        return bool(self._server.get_clients())

    def wait_for_readers(self) -> None:
        """Wait until the last page is closed, or Ctrl-C, or ``leave``."""
        last = time.monotonic()
        try:
            while time.monotonic() - last < RELOAD_TIME:
                if self._leave.wait(REFRESH_PERIOD):
                    return
                if self.has_readers():
                    last = time.monotonic()
        except KeyboardInterrupt:
            return


class _LineByLine:
    """A ``Lidar`` that gives each line as it arrives, so that the button stops within a line."""

    def __init__(self, lidar: Lidar) -> None:
        self._lidar = lidar
        self.read_line = lidar.read_line

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar.spec``."""
        return self._lidar.spec


class _Pace:
    """Slows a twin down to a chosen speed."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._began: tuple[float, float] | None = None

    def wait(self, now: float) -> None:
        """Wait until the twin's time ``now`` [s] is due."""
        if not self._speed:
            return
        if self._began is None:
            self._began = (time.monotonic(), now)
        ahead = (now - self._began[1]) / self._speed - (time.monotonic() - self._began[0])
        if ahead > 0:
            time.sleep(min(ahead, 1.0))
        elif ahead < -1.0:  # after long planning, do not catch up
            self._began = (time.monotonic(), now)


def format_plan(session: Session) -> str:
    """Return the last plan of ``session`` as a table in Markdown."""
    plan = session.plans[-1]
    rows = ["", as_text(plan.reason), ""]
    known = [each for each in plan.candidates if not np.isnan(each.predicted_rmse)]
    if known:
        rows += ["| overlap | predicted error |", "|---:|---:|"]
    for each in known:
        finite = np.isfinite(each.predicted_rmse)
        error = f"{1e3 * each.predicted_rmse:.1f} mm" if finite else "no registration"
        bold = "**" if plan.viewpoint is not None and each.overlap == plan.overlap else ""
        rows.append(f"| {bold}{each.overlap:.0%}{bold} | {bold}{error}{bold} |")
    return "\n".join(rows)


@contextmanager
def open_live_view(
    host: str,
    port: int,
    name: str,
    speed: str | None,
    notify: Callable[[str], None],
    surface: Callable[[], FloatArray] | None = None,
) -> Iterator[LiveView]:
    """Serve the live view of the run called ``name``, and ``notify`` the user of its address.

    The other arguments are those of ``LiveView``.

    Raises:
        LinkError: The view cannot be served there.
    """
    with open_server(host, port, f"{name} - scan3d_twin") as (server, address):
        notify(f"{ADDRESS}{address}")
        if warning := describe_reach(host):
            notify(warning)
        yield LiveView(server, name, speed, notify, surface)
