"""Make the pictures of pages in docs/looking.md: ``python benchmarks/page_pictures.py``.

Writes PNG files to ``docs/images``. Needs Chromium, and the package playwright (group dev).
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

import scan3d_twin as s3d
from scan3d_twin.cli.console.console import Console
from scan3d_twin.cli.console.server import ConsoleServer
from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.observer import Observers, Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.session import Session
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.viz.served.live import ADDRESS, LiveView, open_live_view
from scan3d_twin.viz.served.server import LOOPBACK
from scan3d_twin.viz.true_scene import scene_triangles

FOLDER = Path(__file__).parent.parent / "docs" / "images"
SCENE = "three_boxes"
SHOWN_VIEWS = 2
"""Number of views after which the run waits for its picture."""
SETTLING = 20_000
"""Time in which a browser without a graphics card has drawn a page in 3D [ms]."""
PATIENCE = 60_000
"""Patience with a busy computer [ms]."""
TRUTH = 3
"""Place of the true surface among the checkboxes of the live view."""
NOTICE = ".mantine-Notification-closeButton"
"""Closes what viser says of a browser without a graphics card."""


class PauseAfter(Unobserved):
    """Pauses the run of a live view after some plans."""

    def __init__(self, view: LiveView, plans: int) -> None:
        self._view, self._left = view, plans

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        self._left -= 1
        if self._left == 0:
            self._view.set_pause(True)


@contextmanager
def paused_run() -> Iterator[str]:
    """Give the address of the live view of a run that waits after ``SHOWN_VIEWS`` views."""
    notes: list[str] = []
    scene = load_scene(SCENE)
    with open_live_view(
        LOOPBACK, 0, SCENE, "unlimited", notes.append, lambda: scene_triangles(scene)
    ) as view:
        run = threading.Thread(target=digitize, args=(view,), daemon=True)
        run.start()
        wait(lambda: view.command() == "pause")
        yield notes[0].removeprefix(ADDRESS)  # still paused, the run ends with this program


def digitize(view: LiveView) -> None:
    """Digitise until the run is stopped."""
    try:
        with open_sim(SCENE, 0) as (robot, truth):
            watching = Observers(PauseAfter(view, SHOWN_VIEWS), view)
            config = Config()
            run_loop(
                view.attach(robot, truth), make_planner(config.planner, truth), config, 0, watching
            )
    except KeyboardInterrupt:
        return


@contextmanager
def console_at_work() -> Iterator[str]:
    """Give the address of a console with an earlier run, and one that goes on, in this folder."""
    runs = Path("runs")
    s3d.run_sim(SCENE, options={"max_views": 2}, out=runs / "first")
    console = Console(runs, 0)
    with ConsoleServer(console, 0, "On robot; runs are in runs/") as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        console.start("sim", {"epsilon": "5"}, "")
        wait(lambda: (run := console.snapshot()) is not None and "scanning view 0" in run.lines)
        yield server.address
        server.shutdown()
    console.close()


def wait(done: Callable[[], bool]) -> None:
    """Wait until ``done``."""
    while not done():
        time.sleep(0.1)


def show_truth(page: Any) -> None:
    """Let the live view show the true surface, and nothing in front of it."""
    page.locator(NOTICE).first.click(timeout=PATIENCE)
    page.get_by_role("checkbox").nth(TRUTH).check(force=True, timeout=PATIENCE)
    page.mouse.move(0, 0)  # no tip over the panel
    page.wait_for_timeout(SETTLING)


def wait_for_run(page: Any) -> None:
    """Let the console show its run."""
    page.get_by_text("running", exact=True).wait_for(timeout=PATIENCE)


def shoot(
    browser: Any,
    address: str,
    name: str,
    size: tuple[int, int],
    prepare: Callable[[Any], None],
) -> None:
    """Save what a window of this ``size`` [px] shows at ``address`` when it is prepared."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    page = context.new_page()
    page.goto(address)
    prepare(page)
    page.screenshot(path=FOLDER / name)
    context.close()


def main() -> None:
    """Make both pictures."""
    arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        with paused_run() as address:
            shoot(browser, address, "live_view.png", (1280, 800), show_truth)
        with chdir(folder), console_at_work() as address:
            shoot(browser, address, "console.png", (1100, 1000), wait_for_run)
        browser.close()


if __name__ == "__main__":
    main()
