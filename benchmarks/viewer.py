"""Cost of the live view on the robot's computer, and time to open a recorded session.

Run: .venv/bin/python benchmarks/viewer.py [--seconds 20] [--views 20]

Feeds the live view as a real robot does: lines at 10 Hz, odometry at 30 Hz; --browser attaches a
headless Chromium, whose own time is not counted. Prints the processor time of the fed process with
the view and without, as a share of one core, and the time to load and show a session.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.viz.served.live import LiveView, open_live_view
from scan3d_twin.viz.served.server import LOOPBACK, open_server
from scan3d_twin.viz.served.session_view import SessionView

LINE_PERIOD, TICKS = 0.1, 3
"""Of the lidar [s], and looks at the odometry in it (30 ms apart)."""


class Lines(Unobserved):
    """Keeps the lines of a run."""

    def __init__(self) -> None:
        self.lines: list[ScanLine] = []

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``."""
        self.lines.append(line)


def cost(seconds: float, feed: Callable[[int], None]) -> float:
    """Return this process's share of a core while ``feed`` is called 30 times a second."""
    began, spent = time.monotonic(), time.process_time()
    for k in range(round(seconds / LINE_PERIOD * TICKS)):
        feed(k)
        time.sleep(max(0.0, began + (k + 1) * LINE_PERIOD / TICKS - time.monotonic()))
    return (time.process_time() - spent) / (time.monotonic() - began)


def feeder(view: LiveView | None, lines: list[ScanLine], session: Session) -> Callable[[int], None]:
    """Return a function that feeds ``view`` the next line of the run on each call."""

    def feed(k: int) -> None:
        if view is None:
            return
        view.attend()
        if k % TICKS == 0:
            view.on_line(lines[k // TICKS % len(lines)])
        if k % 300 == 0:
            count = k // 300 % len(session.views) + 1
            seen = replace(session, views=session.views[:count], plans=session.plans[:count])
            view.on_view(seen)
            view.on_plan(seen)

    return feed


def measure_live(seconds: float, browser: bool) -> None:
    lines, planner = Lines(), make_planner("siicp")
    with open_sim("three_boxes", 0) as (robot, _):
        session = run_loop(robot, planner, Config.preset("paper", max_views=4), 0, lines)
        messages: list[str] = []
        with open_live_view(LOOPBACK, 0, "benchmark", None, messages.append) as view:
            view.attach(robot)
            page = _attach(messages[0].removeprefix("live view: ")) if browser else None
            deadline = time.monotonic() + 60
            while browser and not view.has_readers() and time.monotonic() < deadline:
                time.sleep(0.2)
            attached = view.has_readers()
            without = cost(seconds, feeder(None, lines.lines, session))
            with_view = cost(seconds, feeder(view, lines.lines, session))
            if page is not None:
                page.kill()
    watched = "a page attached" if attached else "no page attached"
    print(f"idle {without:.1%}, with the view {with_view:.1%} of a core ({watched})")


def _attach(address: str) -> subprocess.Popen[bytes]:
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("--browser needs Chromium: apt install chromium")
    profile = tempfile.mkdtemp()
    options = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0"]
    return subprocess.Popen(
        [chromium, *options, "--enable-unsafe-swiftshader", f"--user-data-dir={profile}", address],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def measure_session(views: int) -> None:
    from scan3d_twin.cli import main

    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        # No step meets so small an epsilon: the default overlap of 80 % makes many views.
        many = ["--epsilon", "0.1", "--tour", "full", "--max-views", str(views)]
        with contextlib.redirect_stdout(io.StringIO()):
            main(["sim", "--scene", "sine_box", *many, "--out", str(run)])
        began = time.perf_counter()
        from scan3d_twin.recording.load import load_session

        session = load_session(run).session
        loaded = time.perf_counter()
        with open_server(LOOPBACK, 0, "benchmark") as (server, _):
            SessionView(server, "benchmark", session)
            shown = time.perf_counter()
    print(
        f"a session of {len(session.views)} views: loaded in {loaded - began:.2f} s, "
        f"on the page in {shown - loaded:.2f} s more"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--browser", action="store_true")
    arguments = parser.parse_args()
    measure_live(arguments.seconds, arguments.browser)
    if arguments.views:
        measure_session(arguments.views)


if __name__ == "__main__":
    main()
