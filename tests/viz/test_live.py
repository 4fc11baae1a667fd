import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from pixels import SMALL, drawn
from scipy.spatial import cKDTree

from scan3d_twin.api.watch import RunWatcher
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import LinkError
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.core.observer import Observers, Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.surface_samples import sample_triangles
from scan3d_twin.viz.served.banner import COLOURS
from scan3d_twin.viz.served.live import ANNOUNCED, LiveView, format_plan, open_live_view
from scan3d_twin.viz.served.server import LOOPBACK, open_server
from scan3d_twin.viz.true_scene import scene_triangles


@pytest.fixture
def view():
    """A live view of a twin without a speed limit."""
    with open_live_view(LOOPBACK, 0, "boxes", "unlimited", lambda _: None) as opened:
        yield opened


class NotingBase:
    """A base that notes when it was sent which speed."""

    def __init__(self, base, clock):
        self.sent = []
        self._base, self._clock = base, clock

    def __getattr__(self, name):
        return getattr(self._base, name)

    def set_velocity(self, linear, angular):
        self.sent.append((self._clock.now(), linear, angular))
        return self._base.set_velocity(linear, angular)


class Presser(Unobserved):
    """Presses the stop button at the given scan line."""

    def __init__(self, view, line):
        self._view, self._left, self.pressed = view, line, []

    def on_line(self, line):
        self._left -= 1
        if self._left == 0:
            self._view._set_stop()
            self.pressed.append(line.stamp)


def scan(view, press_line=0, press_wait=0):
    """Scan until the button is pressed; return when that was and what the base was sent."""
    pressed = []
    with open_sim("three_boxes", 0) as (robot, _):
        base = NotingBase(robot.base, robot.clock)
        robot = replace(robot, base=base)
        presser = Presser(view, press_line)
        waits = [0]
        attend = view.attend

        def counted():
            waits[0] += 1
            if waits[0] == press_wait:
                view._set_stop()
                pressed.append(robot.clock.now())
            attend()

        view.attend = counted
        try:
            run_loop(
                view.attach(robot),
                make_planner("siicp"),
                paper_config(),
                0,
                Observers(presser, view),
            )
        except KeyboardInterrupt:
            return (pressed or presser.pressed)[0], base.sent
    raise AssertionError("nobody stopped it")


@pytest.mark.parametrize("press", [{"press_line": 20}, {"press_line": 230}, {"press_wait": 60}])
def test_stop_stops_the_wheels_within_a_line(view, press):
    pressed, sent = scan(view, **press)
    stamp, linear, angular = sent[-1]
    assert (linear, angular) == (0.0, 0.0)
    assert stamp - pressed <= 0.2  # a line's stamp is that of its beginning, 0.1 s before
    assert any(each[1:] != (0.0, 0.0) for each in sent[-20:])


def test_the_buttons_command_what_they_say(view):
    assert view.command() == "go"
    view.set_pause(True)
    assert view.command() == "pause"
    view.set_pause(False)
    assert view.command() == "go"
    view._set_stop()
    assert view.command() == "stop"


def test_the_banner_says_how_the_run_stands(view):
    assert view._banner.state == "waiting"
    with open_sim("three_boxes", 0) as (robot, _):
        view.attach(robot)
    assert view._banner.state == "running"
    view.set_pause(True)
    assert view._banner.state == "pausing"
    view.command()
    assert view._banner.state == "paused"
    view.set_pause(False)
    assert view._banner.state == "running"
    view._set_stop()
    view.set_pause(True)
    assert view._banner.state == "stopped"
    view.finish("interrupted")
    assert view._banner.state == "stopped"


@pytest.mark.parametrize(
    ("ended", "state"),
    [(None, "finished"), (KeyboardInterrupt(), "stopped"), (LinkError("unplugged"), "failed")],
)
def test_the_banner_says_how_the_run_ended(view, ended, state):
    RunWatcher(view, bytes).finish("over", lambda _: None, ended)
    assert view._banner.state == state
    assert f">{state}</div>" in view._banner._html.content


def test_text_on_the_banner_has_enough_contrast():
    def luminance(colour):
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return linear @ (0.2126, 0.7152, 0.0722)

    for colour in COLOURS.values():
        assert 1.05 / (luminance(colour) + 0.05) >= 4.5  # WCAG AA, white text


@pytest.fixture(scope="module")
def watched():
    """A live view of two views in the twin; the session, its evaluation and the ways drawn."""
    scene, drawn = load_scene("three_boxes"), []
    with (
        open_live_view(
            LOOPBACK, 0, "boxes", "unlimited", lambda _: None, lambda: scene_triangles(scene)
        ) as view,
        open_sim("three_boxes", 0) as (robot, truth),
    ):
        view.stage.show_path = lambda places: drawn.append(places)
        robot = view.attach(robot, truth)
        assert view._place_surface() is None  # the first view defines where it is
        session = run_loop(robot, make_planner("siicp"), paper_config(max_views=2), 0, view)
        yield view, session, evaluate(session, truth), drawn


def test_the_way_driven_is_drawn_as_it_is_driven(watched):
    _, session, _, drawn = watched
    end = session.views[-1].T_world_scan
    way = drawn[-1]
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert len(way) > 3
    assert steps.max() < 0.2  # however seldom it is drawn: a place every 0.1 m
    assert np.linalg.norm(way[-1] - (end.x, end.y)) < 0.15


def test_in_the_twin_the_realised_errors_and_the_true_surface_are_shown(watched):
    view, session, evaluation, _ = watched
    error = evaluation.pairs[0].error
    shown = f"{1e3 * error:.1f} mm"
    shown = f"**{shown}**" if error > session.config.planning.epsilon else shown
    assert f"| {shown} |" in view._errors.content
    assert "realised" in view._errors.content

    # The true surface lies on the model
    points, _ = sample_triangles(view._place_surface(), 0.005)
    off, _ = cKDTree(points).query(build_model(session).points)
    assert np.median(off) < 0.010  # range noise of the lidar


def test_a_pause_is_said_once():
    notes = []
    with open_live_view(LOOPBACK, 0, "boxes", "unlimited", notes.append) as view:
        view.set_pause(True)
        view.set_pause(True)
        assert view.command() == view.command() == "pause"
        view.set_pause(False)
    assert notes[1:] == [ANNOUNCED["pausing"], ANNOUNCED["paused"], ANNOUNCED["running"]]


def test_watching_changes_nothing(watched):
    with open_sim("three_boxes", 0) as (robot, _):
        config = paper_config(max_views=2)
        alone = run_loop(robot, make_planner("siicp"), config, 0, Unobserved())
    for mine, other in zip(watched[1].views, alone.views, strict=True):
        assert mine.T_world_scan == other.T_world_scan
        np.testing.assert_array_equal(mine.observation.image.ranges, other.observation.image.ranges)


def test_a_slow_speed_keeps_the_twin_at_it(view):
    view._set_speed("10x")
    with open_sim("three_boxes", 0) as (robot, _):
        watched = view.attach(robot)
        began = time.monotonic()
        for _ in range(100):
            watched.clock.sleep(0.03)
        assert time.monotonic() - began >= 0.9 * 3.0 / 10


def test_the_plan_is_told_as_a_table(session):
    table = format_plan(replace(session, plans=session.plans[:2]))
    assert "| 20% | no registration |" in table
    assert "| **80%** | **15.0 mm** |" in table


def test_a_port_in_use_is_an_error_that_says_so():
    with open_server(LOOPBACK, 0, "first") as (server, _):
        port = server.get_port()
        with pytest.raises(LinkError, match=f"cannot serve the view at {LOOPBACK}:{port}"):
            open_server(LOOPBACK, port, "second").__enter__()


def test_only_this_machine_is_served_unless_told():
    with open_server(LOOPBACK, 0, "here") as (server, address):
        assert server.get_host() == LOOPBACK
        assert address.startswith("http://127.0.0.1:")


class Run(threading.Thread):
    """A run in the twin that is watched, on a thread of its own."""

    def __init__(self, view: LiveView):
        super().__init__(daemon=True)
        self.view, self.error, self.session = view, None, None

    def run(self):
        try:
            with open_sim("three_boxes", 0) as (robot, _):
                robot = self.view.attach(robot)
                planner = make_planner("siicp")
                self.session = run_loop(robot, planner, paper_config(), 0, self.view)
        except KeyboardInterrupt as error:
            self.error = error
        self.view.finish("over")


def test_a_run_can_be_watched_paused_continued_and_stopped_in_a_browser(open_page):
    notes = []
    with open_live_view(LOOPBACK, 0, "boxes", "unlimited", notes.append) as view:
        run = Run(view)
        view.set_pause(True)  # so that the page comes in time for the first view
        run.start()
        shown = open_page(notes[0].removeprefix("live view: "), **SMALL)
        page = shown.page
        page.get_by_text("paused", exact=True).wait_for()
        page.get_by_text("1 views").wait_for()
        assert drawn(page, {0}, views=(0, 2)) == {0}
        page.get_by_text("predicted error").wait_for()
        view._set_speed("10x")
        page.get_by_role("button", name="Continue").click()
        page.get_by_text("driving to viewpoint 1").wait_for()
        assert run.is_alive()
        page.get_by_role("button", name="Stop").click()
        run.join(10)
        assert not run.is_alive()
        assert isinstance(run.error, KeyboardInterrupt)
        page.get_by_text("over", exact=True).wait_for()
        page.get_by_role("button", name="Stop").wait_for(state="hidden")
        assert (shown.errors, shown.asked) == ([], [])
